"""A run's lanes as TuSimple files, and their score against such files."""
