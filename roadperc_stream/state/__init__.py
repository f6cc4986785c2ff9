"""What a replay leaves to the next one: the state at the end of a part of a drive, and checkpoints within one."""
