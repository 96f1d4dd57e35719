"""Where a viewer's data go: a window of rerun, or a file that rerun opens later."""

import importlib.util
import os
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stillroom.errors import ConfigError, MissingExtraError, StillroomError

IMAGE, TIME = "image", "time"
"""The timelines: number of the image in its sequence, and time since the first image [s]."""

SUFFIX = ".rrd"
PATIENCE_S = 3.0
"""How long a window may take to receive what was sent before it counts as gone."""

PATIENCE_WITH_FILE_S = 10.0
"""How long a disk may take. A full one is found by waiting too: rerun's own thread writes the file."""

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
"""Variables that name a display on Linux."""

INSTEAD = "write a file with --rerun FILE.rrd, and open it where there is a display [see troubleshooting: viewer]"

QUIET = "off"
"""For rerun's own log, which would repeat on stderr what is raised here."""


@dataclass(frozen=True)
class Destination:
    """Where to show a run.

    Attributes:
        file: The `.rrd` file to write; None for a window.
    """

    file: Path | None = None

    def require_usable(self) -> None:
        """See to it that rerun is installed, and there is a display, or a place for the file; nothing is opened.

        Raises:
            MissingExtraError: rerun is not installed.
            ConfigError: There is no display for a window; the file has another suffix, or no folder to lie in.
        """
        require_rerun()
        if self.file is None:
            if sys.platform == "linux" and not any(map(os.environ.get, DISPLAYS)):
                raise ConfigError(f"there is no display for the viewer's window; {INSTEAD}")
            return
        if self.file.suffix != SUFFIX:
            raise ConfigError(f"{self.file}: rerun knows its files by their suffix; let the name end in {SUFFIX}")
        if self.file.is_dir() or not self.file.parent.is_dir():
            raise ConfigError(f"{self.file}: cannot be written there; name a file in a folder that exists")

    def open(self, name: str) -> "Recording":
        """Begin a recording; a file that is there is replaced.

        Args:
            name: Shown by the viewer.

        Raises:
            MissingExtraError, ConfigError: As `require_usable`.
            StillroomError: The file cannot be written, or the window does not open.
        """
        self.require_usable()
        return Recording(self, name)


class Recording:
    """Takes what is shown, at the image and time that were named last."""

    def __init__(self, destination: Destination, name: str) -> None:
        """Open the destination; see `Destination.open`."""
        self.rr: Any = load_rerun()
        self._destination = destination
        self._stream = self.rr.RecordingStream("stillroom")
        # Images have times of their own; those of logging would be two more timelines to choose from.
        self._stream.set_log_time_enabled(False)
        self._stream.set_log_tick_enabled(False)
        try:
            if destination.file is not None:
                self._stream.save(destination.file)
            else:
                self._open_window()
        except RuntimeError as error:
            raise StillroomError(_why_not(destination, error)) from error
        self._stream.send_recording_name(name)

    @property
    def is_file(self) -> bool:
        """Whether it goes into a file, and is looked at later."""
        return self._destination.file is not None

    def at(self, index: int, time_s: float) -> None:
        """Set the number of the image, and the time since the first image [s], of what follows."""
        self._stream.set_time(IMAGE, sequence=index)
        self._stream.set_time(TIME, duration=time_s)

    def log(self, path: str | list[str], *shown: Any, static: bool = False) -> None:
        """Show something (archetypes of rerun) under the name of an entity.

        Args:
            path: Its name, with slashes; or its parts, which may then hold any characters.
            shown: What it shows.
            static: Whether it is valid at all times.
        """
        self._stream.log(path, *shown, static=static)

    def arrange(self, blueprint: Any) -> None:
        """Let the viewer arrange its views so."""
        self._stream.send_blueprint(blueprint)

    def flush(self) -> None:
        """Wait until all is delivered.

        Raises:
            StillroomError: It is not, after a while: the window was closed, or the disk is full.
        """
        file = self._destination.file
        try:
            self._stream.flush(timeout_sec=PATIENCE_S if file is None else PATIENCE_WITH_FILE_S)
        except RuntimeError as error:
            gone = "its window was closed, or does not answer" if file is None else f"{file} cannot be written on"
            raise StillroomError(f"{gone} ({_first_line(error)})") from error

    def close(self) -> None:
        """Let go of the file or window; the window stays open."""
        self._stream.disconnect()

    def abandon(self) -> None:
        """Let go of a file or window that does not take anything any more, without waiting for it.

        rerun would wait for it when the program ends, for ever where a window hangs; so it is told not to, and a
        daemon thread takes the wait over.
        """
        self.rr.unregister_shutdown()
        threading.Thread(target=self._stream.disconnect, name="abandoned viewer", daemon=True).start()

    def _open_window(self) -> None:
        import rerun_cli

        folder = Path(rerun_cli.__file__).parent
        # The viewer's own program, which need not be on PATH: `python -m` in an environment that is not activated.
        found = next((path for path in (folder / "rerun", folder / "rerun.exe") if path.is_file()), None)
        self.rr.spawn(executable_path=None if found is None else str(found), recording=self._stream)


def require_rerun() -> None:
    """See to it that rerun is installed, without the seconds that importing it takes.

    Raises:
        MissingExtraError: It is not.
    """
    if importlib.util.find_spec("rerun") is None:
        raise MissingExtraError("rerun-sdk", "viewer")


def load_rerun() -> Any:
    """Import rerun.

    Raises:
        MissingExtraError: It is not installed.
    """
    os.environ.setdefault("RUST_LOG", QUIET)
    try:
        import rerun
    except ImportError:
        raise MissingExtraError("rerun-sdk", "viewer") from None
    return rerun


def _why_not(destination: Destination, error: Exception) -> str:
    if destination.file is not None:
        return f"{destination.file}: cannot be written ({_first_line(error)}); choose another place"
    return f"the viewer's window does not open ({_first_line(error)}); {INSTEAD}"


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0] or type(error).__name__
