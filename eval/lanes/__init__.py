"""The lanes of a run in the formats of TuSimple and CULane, and their scores against true lanes."""
