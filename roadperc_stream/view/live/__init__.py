"""Serves logs to Foxglove with play, pause, seek and speed: finished ones, and those a replay is writing.

Commands use ``options.add_playback_arguments``, ``options.playback_options`` and ``serving.serve_log``.
"""
