"""No character ends a command, whatever the code page of the terminal."""

import io
import sys
from pathlib import Path

import pytest

from stillroom.cli.main import main


@pytest.mark.parametrize("code_page", ["cp437", "cp932", "cp1252", "ascii"])
def test_what_a_code_page_lacks_is_a_question_mark(
    code_page: str, recorded: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = {name: io.BytesIO() for name in ("stdout", "stderr")}
    for name, buffer in written.items():
        monkeypatch.setattr(sys, name, io.TextIOWrapper(buffer, encoding=code_page, errors="strict"))
    monkeypatch.chdir(recorded.parent)
    text = str(recorded / "groundtruth.txt")
    with pytest.raises(SystemExit) as left:
        main(["evaluate", "--estimate", text, "--groundtruth", text, "--baseline", text, "--out", "né…"])
    for name in written:
        getattr(sys, name).flush()
    out = written["stdout"].getvalue().decode(code_page)
    assert not left.value.code, written["stderr"].getvalue()
    assert "?" in out  # for what the code page lacks: the minus sign of a formula, or letters of the folder's name
    assert "improvement over" in out

    with pytest.raises(SystemExit) as left:
        main(["evaluate", "--estimate", "没有.tum", "--groundtruth", text])
    sys.stderr.flush()
    assert left.value.code == 1
    assert "no such file" in written["stderr"].getvalue().decode(code_page)
