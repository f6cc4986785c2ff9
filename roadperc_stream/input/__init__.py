"""From a log to frames: which channel fills which role, decoding, transforms, synchronisation, assembly."""
