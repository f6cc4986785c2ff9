"""Log records of libraries, escaped as the lines of the commands."""

import logging
from typing import Any

from roadperc_stream.system.text import shown


class ShownRecord(logging.LogRecord):
    """A record with escaped message and traceback: libraries may log text from a file or a client."""

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        if self.exc_info:
            self.exc_text = shown(logging.Formatter().formatException(self.exc_info))

    def getMessage(self) -> str:
        """The escaped message."""
        return shown(super().getMessage())
