"""From results to what is written: messages, tables, pictures."""
