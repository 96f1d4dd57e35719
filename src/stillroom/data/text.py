"""Text that users wrote, with whatever editor."""

import codecs
from pathlib import Path

UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file; a byte order mark, as Windows' editors write it, is no part of it.

    Raises:
        OSError: The file cannot be read.
        UnicodeError: It is no such text.
    """
    content = path.read_bytes()
    if content.startswith(UTF_16):
        raise UnicodeError("it is UTF-16; save it as UTF-8")
    if b"\0" in content:  # no file can have such a name, and no text has such a letter
        raise UnicodeError("it holds zero bytes, so it is no text")
    return content.decode("utf-8-sig")
