"""A structure-aware fuzzer: inputs that are wrong in some place, given to every command.

A case is a recipe: what a tiny log, a table, a configuration, true lanes or a dump of frames holds, what of it is
changed, and the command that gets it. Recipes are drawn from a seed and a number (``choices.py``), and everything they
choose is noted, so that a recipe repeats its case without them.

- ``contents.py`` makes the drives, in every schema that is read; ``messages.py`` changes messages, order, times,
  channels, attachments; ``trees.py`` fields of protobuf and JSON, ``pictures.py`` PNG and JPEG, ``records.py`` the
  records of the file, whose checksums and offsets are put right afterwards or not; ``choices.py`` bytes.
- ``tables.py``, ``trees.py`` (TOML) and ``dumps.py`` are for the other inputs; ``cases.py`` puts them together.
- ``judge.py`` holds the promise: exit code 0 to 3, one line on stderr where it is not 0, no traceback and no line of a
  C library, no control characters, nothing half written; ``trying.py`` adds that logs that are written are whole by
  roadperc-info and by a second reader, and that a replay gives the same bytes again.
- ``trying.py`` tries each case in a forked process, whose memory may grow by 1.25 GB and whose command has ten
  seconds of the processor.
- ``corpus/`` holds what was found.
"""
