"""The commands: one thin module each, with its arguments; the module that does the work is imported when it runs."""
