"""Files on this machine or in an object store, by their paths or addresses."""
