"""Replay camera logs through one perception chain, frame by frame, the same way every time."""

TYPE_CHECKING = False  # typing itself would be half the time that importing this takes

__version__: str

if not TYPE_CHECKING:

    def __getattr__(name: str) -> str:
        """The version when it is asked for: importlib.metadata takes longer than all that a command does before."""
        if name != "__version__":
            raise AttributeError(name)
        from importlib.metadata import version  # noqa: PLC0415

        return version("roadperc_stream")
