"""Message definitions and their packing."""
