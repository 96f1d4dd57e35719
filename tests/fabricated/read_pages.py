"""What a page says, read back with the parser of the standard library."""

import re
from html.parser import HTMLParser
from pathlib import Path

ADDRESSES = {"src", "href", "srcset", "poster", "data", "action"}
REMOTE_IN_STYLE = re.compile(r"url\(\s*['\"]?(?!data:)|@import", re.IGNORECASE)
UNSEEN = {"script", "style"}


class ReadPage(HTMLParser):
    """A page that was written.

    Attributes:
        text: What a reader sees, in one line.
        numbers: Exact values behind the figures, in order.
        addresses: All that a browser might load.
        pictures: Addresses of the pictures.
        captions: What stands below them.
        n_bytes: Size of the file.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.numbers: list[float] = []
        self.addresses: list[str] = []
        self.pictures: list[str] = []
        self.captions: list[str] = []
        self.styles, self.scripts = "", ""
        self._words: list[str] = []
        self._open: list[str] = []
        source = path.read_bytes()
        self.n_bytes = len(source)
        self.feed(source.decode("utf-8"))
        self.close()
        self.text = " ".join(" ".join(self._words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.addresses += [str(given[name]) for name in ADDRESSES & given.keys()]
        if tag == "data":
            self.numbers.append(float(str(given["value"])))
        elif tag == "img":
            self.pictures.append(str(given["src"]))
        if tag not in {"meta", "link", "img", "br"}:
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag, f"{tag} is closed and was not the last that was opened"

    def handle_data(self, data: str) -> None:
        place = self._open[-1] if self._open else ""
        if place == "style":
            self.styles += data
        elif place == "script":
            self.scripts += data
        else:
            self._words.append(data)
            if place == "figcaption":
                self.captions.append(data)

    @property
    def asks_the_network(self) -> list[str]:
        """Addresses that are not in the page itself."""
        odd = [address for address in self.addresses if not address.startswith(("data:", "#"))]
        return odd + REMOTE_IN_STYLE.findall(self.styles)
