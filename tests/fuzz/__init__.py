"""A structure-aware fuzzer: it gives every command wrong inputs.

A case is a recipe: the content of a small log, table, configuration, lane file or dump, the changes to it, and the
command. The recipe records every choice, so it repeats its case. Without a recipe the choices follow from the case's
name, a seed and a number (``choices.py``).

- ``contents.py`` makes logs in every schema that is read. ``messages.py`` changes messages, order, times, channels and
  attachments; ``trees.py`` fields of protobuf, ROS, JSON and TOML; ``pictures.py`` PNG and JPEG; ``records.py`` MCAP
  records, whose checksums and offsets are repaired afterwards or left wrong; ``choices.py`` bytes.
- ``tables.py`` and ``dumps.py`` make the other inputs. ``cases.py`` combines them.
- ``judge.py`` checks the output of a command: exit code 0 to 3, one line on stderr on failure, no traceback, no text
  of C libraries, no control characters, no partial files.
- ``trying.py`` runs each case in a forked process with 1.25 GB more memory and ten seconds of CPU time. It also checks
  that written logs are valid and that a repeated replay gives the same bytes.
- ``corpus/`` holds the recipes of earlier failures.
"""
