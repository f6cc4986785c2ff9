"""Wrong input of any kind ends in a result or one clear error line: hypothesis makes it, a module for each kind."""
