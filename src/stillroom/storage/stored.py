"""What a map file holds, beside the tables of the map itself."""

from dataclasses import dataclass

from stillroom.data.map import Map
from stillroom.data.result import FrameResult
from stillroom.geometry.arrays import F64
from stillroom.geometry.camera import Camera


@dataclass(frozen=True)
class Session:
    """One run that made the map or went on with it.

    Attributes:
        first_keyframe: Id from which on the keyframes are this session's, until the next one's.
        started: When, ISO 8601.
        stillroom: Version of the program.
        source_commit: Its git commit, where known.
        sequence: Name of the sequence.
        method: Name of the method.
        seed: Where every random choice started.
        vocabulary: The file of the vocabulary by which it recognised places; "" for the one that is shipped.
        vocabulary_digest: Names that very vocabulary. No words are stored: they are looked up anew.
        config: The effective config as TOML.
    """

    first_keyframe: int
    started: str
    stillroom: str
    source_commit: str
    sequence: str
    method: str
    seed: int
    vocabulary: str
    vocabulary_digest: str
    config: str


@dataclass(frozen=True)
class FrameNote:
    """A tracked frame, hung on its reference keyframe.

    Attributes:
        session: Which session it belongs to, from 0.
        image_index: Number of the image in its sequence.
        timestamp_s: Its time [s].
        reference_keyframe: Id of the keyframe it hangs on.
        T_reference_cam: Its pose in that keyframe (4, 4).
    """

    session: int
    image_index: int
    timestamp_s: float
    reference_keyframe: int
    T_reference_cam: F64

    @classmethod
    def of(cls, result: FrameResult, session: int) -> "FrameNote | None":
        """Return the note of a frame; None of one that was lost."""
        if result.T_reference_cam is None:
            return None
        return cls(session, result.index, result.timestamp_s, result.reference_keyframe, result.T_reference_cam)


@dataclass(frozen=True)
class StoredMap:
    """All that a map file holds, but the images of its keyframes.

    Attributes:
        world: The map.
        camera: The camera that took it.
        sessions: The runs that made it, oldest first.
        frames: The frames that they tracked, in order of session and image.
    """

    world: Map
    camera: Camera
    sessions: tuple[Session, ...] = ()
    frames: tuple[FrameNote, ...] = ()
