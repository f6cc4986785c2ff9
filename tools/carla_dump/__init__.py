"""Reading a dump folder: which files are there, what they hold, and the messages they become."""
