"""Files as they come out of damage: seeded mutations of bytes and of lines."""

from collections.abc import Iterator

import numpy as np

TOKENS = (
    b"", b"0", b"-1", b"1e999", b"nan", b"inf", b"1" * 400, b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"../../escaped",
    b"/etc/passwd", b"=", b"[", b"]", b'"', b"#", b",", b"true", b"99999999999999999999", b"-0.0", b"\r", b"\n\n",
)  # fmt: skip
"""What parsers stumble over."""


def mutated(seed: bytes, rng: np.random.Generator) -> bytes:
    """Return a file with one to eight faults."""
    content = bytearray(seed)
    for _ in range(int(rng.integers(1, 9))):
        fault = FAULTS[int(rng.integers(len(FAULTS)))]
        content = bytearray(fault(bytes(content), rng))
    return bytes(content)


def mutations(seed: bytes, n: int, number: int) -> Iterator[bytes]:
    """Yield `n` damaged files; the same for the same number."""
    rng = np.random.default_rng(number)
    yield seed
    yield b""
    for _ in range(n):
        yield mutated(seed, rng)


def _place(content: bytes, rng: np.random.Generator) -> int:
    """Return a place in a file; headers are short, and half of all faults fall there."""
    end = len(content) if rng.random() < 0.5 else min(len(content), 200)
    return int(rng.integers(end + 1))


def _flipped(content: bytes, rng: np.random.Generator) -> bytes:
    at = _place(content, rng)
    return content[:at] + bytes([int(rng.integers(256))]) + content[at + 1 :]


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    at = _place(content, rng)
    return content[:at] + content[at + int(rng.integers(1, 64)) :]


def _truncated(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: _place(content, rng)]


def _inserted(content: bytes, rng: np.random.Generator) -> bytes:
    at = _place(content, rng)
    return content[:at] + TOKENS[int(rng.integers(len(TOKENS)))] + content[at:]


def _word_replaced(content: bytes, rng: np.random.Generator) -> bytes:
    lines = content.split(b"\n")
    row = int(rng.integers(len(lines)))
    words = lines[row].split(b" ")
    words[int(rng.integers(len(words)))] = TOKENS[int(rng.integers(len(TOKENS)))]
    lines[row] = b" ".join(words)
    return b"\n".join(lines)


def _line_moved(content: bytes, rng: np.random.Generator) -> bytes:
    lines = content.split(b"\n")
    first, second = (int(each) for each in rng.integers(len(lines), size=2))
    lines[first], lines[second] = lines[second], lines[first]
    return b"\n".join(lines)


def _line_repeated(content: bytes, rng: np.random.Generator) -> bytes:
    lines = content.split(b"\n")
    row = int(rng.integers(len(lines)))
    return b"\n".join([*lines[:row], lines[row], *lines[row:]])


def _number_written(content: bytes, rng: np.random.Generator) -> bytes:
    """Put a large or negative number where a format may keep a count."""
    at, width = _place(content, rng), int(rng.choice([1, 2, 4, 8]))
    number = int(rng.choice([0, 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1])) % 256**width
    return content[:at] + number.to_bytes(width, "little") + content[at + width :]


FAULTS = (
    _flipped, _cut, _truncated, _inserted, _word_replaced, _line_moved, _line_repeated, _number_written,
)  # fmt: skip
