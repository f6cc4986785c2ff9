"""The commands: a thin file each, with its arguments; what does the work is imported when it runs."""
