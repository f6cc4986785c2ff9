"""``roadperc-info``: the contents of a log, its damage, and its suitability for a replay."""
