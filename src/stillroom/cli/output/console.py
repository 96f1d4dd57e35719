"""The two streams, and how errors and warnings look on them."""

import logging

from rich.console import Console
from rich.markup import escape

WIDTH_WITHOUT_TERMINAL = 120


def _console(stderr: bool) -> Console:
    console = Console(stderr=stderr)
    if not console.is_terminal:
        console.width = max(console.width, WIDTH_WITHOUT_TERMINAL)
    return console


STDOUT = _console(stderr=False)
STDERR = _console(stderr=True)


def print_error(message: str) -> None:
    """Print an error as one line, however long."""
    _one_line("[bold red]error:[/] ", message)


def say(message: str) -> None:
    """Print a remark on stderr as one line."""
    _one_line("", message)


def show_log() -> None:
    """Let the package's warnings appear on stderr, each as one line."""
    logger = logging.getLogger("stillroom")
    if not any(isinstance(handler, _OneLine) for handler in logger.handlers):
        logger.addHandler(_OneLine(logging.WARNING))


class _OneLine(logging.Handler):
    """Prints through the console, so that a progress bar stays whole."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print the record."""
        color = "yellow" if record.levelno < logging.ERROR else "bold red"
        _one_line(f"[{color}]{record.levelname.lower()}:[/] ", record.getMessage())


def _one_line(prefix: str, message: str) -> None:
    text = " ".join(message.split())
    STDERR.print(f"{prefix}{escape(text)}", soft_wrap=True, highlight=False)
