from .data.dense_cloud import DenseCloud as DenseCloud
from .data.image import Image as Image
from .data.image import MonoImage as MonoImage
from .data.image import RgbdImage as RgbdImage
from .data.image import StereoImage as StereoImage
from .data.motion import Motion as Motion
from .data.result import FrameResult as FrameResult
from .data.result import TrackingState as TrackingState
from .data.semantics import Box as Box
from .data.semantics import Instance as Instance
from .data.semantics import Semantics as Semantics
from .data.trajectory import Trajectory as Trajectory
from .datasets.open import open_dataset as open_dataset
from .datasets.selection import select as select
from .errors import StillroomError as StillroomError
from .evaluation.report import Evaluation as Evaluation
from .geometry.camera import Camera as Camera
from .presets.registry import configure as configure
from .session.front_door import camera as camera
from .session.front_door import evaluate as evaluate
from .session.front_door import load_map as load_map
from .session.front_door import methods as methods
from .session.slam import Slam as Slam

__version__: str
