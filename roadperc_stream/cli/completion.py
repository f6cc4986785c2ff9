"""Shell completion by argcomplete: asks the parser what could come next. Imported where a shell asks alone."""

import argparse

import argcomplete
from argcomplete.completers import SuppressCompleter


def complete(parser: argparse.ArgumentParser) -> None:
    """Answer the shell that has set ``_ARGCOMPLETE``, and end; an argument without a completer gets no files."""
    argcomplete.autocomplete(parser, always_complete_options=False, default_completer=SuppressCompleter())
