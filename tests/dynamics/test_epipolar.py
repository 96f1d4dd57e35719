"""The sieve of `oc-slam`: in a box all moves that was not seen at its place before, and what left its epipolar line."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from asked import ask
from flat_wall import before_the_wall, in_box, points_on_the_wall
from small_world import SmallMap, no_semantics, pose

from stillroom.data.frame import Frame
from stillroom.data.matches import Matches
from stillroom.data.motion import Motion, Stage
from stillroom.data.semantics import Box, Semantics
from stillroom.dynamics.depth_history import DepthHistoryConfig
from stillroom.dynamics.epipolar_sieve import EpipolarConfig, EpipolarSieve
from stillroom.geometry import se3
from stillroom.schedule import Done

WALL = points_on_the_wall(5, 900)
FIRST, SECOND, NOW = pose(), pose(0.1, 0.02), pose(0.25, -0.1, turn=(0.01, -0.02, 0.03))
# Away from the borders: all that lies in the boxes now was in view from the keyframes.
BOX, FIGURE = Box(150, 70, 479, 409, "person", 0.9), Box(150, 70, 299, 409, "person", 0.9)
CROWD = Semantics(480, 640, (BOX,))
FRAME_NUMBER = 60
"""Two seconds after the keyframes."""
STAGES = [Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME, Stage.LOCAL_MAP]


@dataclass
class Scene:
    """A wall seen from two keyframes, and now; a figure may stand before its left part now."""

    small: SmallMap = field(default_factory=lambda: SmallMap.of(WALL, [FIRST, SECOND]))
    frame: Frame = field(init=False)
    matches: Matches = field(init=False)

    def __post_init__(self) -> None:
        frame, seen = WALL.look(NOW, seed=9, index=FRAME_NUMBER)
        self.frame, self.matches = before_the_wall(frame, NOW), Matches.of(self.small.id_of[seen])

    def with_figure(self) -> "Scene":
        self.frame = before_the_wall(self.frame, NOW, FIGURE)
        return self

    def sieve(self, past: bool = True, **config: float) -> EpipolarSieve:
        """A sieve that saw the empty wall from the keyframes, a second or more ago."""
        sieve = EpipolarConfig(**config).build()
        for index, T_world_cam in ((0, FIRST), (30, SECOND)) if past else ():
            before = replace(self.frame, image=replace(self.frame.image, index=index, timestamp_s=index / 30.0))
            self.ask(Stage.LOCAL_MAP, sieve, before_the_wall(before, T_world_cam), T_world_cam)
        return sieve

    def ask(
        self,
        stage: Stage,
        sieve: EpipolarSieve,
        frame: Frame | None = None,
        T_world_cam: np.ndarray = NOW,
        matches: Matches | None = None,
        semantics: Semantics = CROWD,
    ) -> Motion:
        matches = self.matches if matches is None else matches
        T_cam_world = se3.inverse(T_world_cam)
        return ask(sieve, stage, frame or self.frame, matches, Done(semantics), T_cam_world, self.small.map)

    @property
    def inside(self) -> np.ndarray:
        return in_box(self.frame, BOX)

    def inside_and_matched(self) -> np.ndarray:
        """Keypoints (K,) in the box that see a point of the map."""
        return np.intersect1d(np.flatnonzero(self.inside), self.matches.keypoint)

    def moved(self, keypoints: np.ndarray, by_px: float) -> Frame:
        """The frame with keypoints (K,) off their lines by so many pixels of their pyramid level."""
        kp = self.frame.keypoints
        scale = self.frame.scales.factors[kp.octave[keypoints], None]
        px = kp.px.copy()
        px[keypoints] += (by_px * scale * self.normals(keypoints)).astype(np.float32)
        return replace(self.frame, keypoints=replace(kp, px=px))

    def normals(self, keypoints: np.ndarray) -> np.ndarray:
        """Unit normals (K, 2) of the epipolar lines of keypoints, drawn from the keyframe that saw each first.

        Plainly: its ray there, cut at two depths, as the present camera sees it.
        """
        id_of = dict(zip(self.matches.keypoint.tolist(), self.matches.point_id.tolist(), strict=True))
        found = []
        for keypoint in keypoints.tolist():
            point = id_of[keypoint]
            first = 0 if point in self.small.map.points_of(0) else 1
            rows = self.small.map.rows(first)
            row = rows.start + self.small.map.points_of(first).tolist().index(point)
            px = self.small.map.keypoints.px[row : row + 1].astype(np.float64).repeat(2, axis=0)
            camera = self.frame.camera
            T_now_first = np.linalg.inv(NOW) @ (FIRST, SECOND)[first]
            ends = camera.project(se3.transform(T_now_first, camera.back_project(px, np.array([1.0, 9.0]))))
            along = ends[1] - ends[0]
            found.append(np.array([-along[1], along[0]]) / np.linalg.norm(along))
        return np.array(found)


@pytest.fixture
def scene() -> Scene:
    return Scene()


def without(scene: Scene, keypoints: np.ndarray) -> np.ndarray:
    """All static but some keypoints."""
    is_static = np.ones(len(scene.frame), np.bool_)
    is_static[keypoints] = False
    return is_static


def test_the_scene_is_worth_asking_about(scene: Scene) -> None:
    assert len(scene.inside_and_matched()) > 150
    assert (~scene.inside)[scene.matches.keypoint].sum() > 100
    first = scene.small.map.points.first_keyframe[scene.matches.point_id]
    assert min((first == 0).sum(), (first == 1).sum()) > 5, "points that either keyframe saw first"
    assert len(np.unique(scene.frame.keypoints.octave[scene.inside_and_matched()])) > 3


@pytest.mark.parametrize("stage", STAGES)
def test_a_wall_in_a_box_was_there_before_and_stays(scene: Scene, stage: Stage) -> None:
    motion = scene.ask(stage, scene.sieve())
    assert motion.is_static.all()
    np.testing.assert_array_equal(motion.moving, CROWD.movable)


@pytest.mark.parametrize("stage", STAGES)
def test_who_walked_in_goes_matched_or_not_and_the_wall_beside_stays(scene: Scene, stage: Stage) -> None:
    sieve = scene.sieve()
    figure = np.flatnonzero(in_box(scene.with_figure().frame, FIGURE))
    assert len(figure) > 80
    np.testing.assert_array_equal(scene.ask(stage, sieve).is_static, without(scene, figure))
    half = scene.matches.keep(~np.isin(scene.matches.keypoint, figure[::2]))
    np.testing.assert_array_equal(scene.ask(stage, sieve, matches=half).is_static, without(scene, figure))


def test_in_a_box_all_moves_until_it_is_shown_to_be_static(scene: Scene) -> None:
    """At the first frame there is no past; a keypoint without depth has none at any time."""
    sieve = scene.sieve(past=False)
    np.testing.assert_array_equal(scene.ask(Stage.LOCAL_MAP, sieve).is_static, ~scene.inside)
    inside = np.flatnonzero(scene.inside)
    depth_m = scene.frame.keypoints.depth_m.copy()
    depth_m[inside[::3]] = 0
    blind = replace(scene.frame, keypoints=replace(scene.frame.keypoints, depth_m=depth_m))
    motion = scene.ask(Stage.LOCAL_MAP, scene.sieve(), blind)
    np.testing.assert_array_equal(motion.is_static, without(scene, inside[::3]))


def test_only_images_of_the_local_map_stage_are_remembered(scene: Scene) -> None:
    """Before it, the pose is a guess."""
    sieve = scene.sieve(past=False)
    for stage in (Stage.MOTION_MODEL, Stage.REFERENCE_KEYFRAME, Stage.RELOCALIZATION):
        before = replace(scene.frame, image=replace(scene.frame.image, timestamp_s=1.0))
        scene.ask(stage, sieve, before)
    np.testing.assert_array_equal(scene.ask(Stage.LOCAL_MAP, sieve).is_static, ~scene.inside)


def test_one_image_that_saw_the_place_empty_overrules_those_that_agree(scene: Scene) -> None:
    """A figure that stands where it stood a second ago, but not two seconds ago."""
    sieve = scene.sieve(past=False)
    for index, T_world_cam, figure in ((0, FIRST, None), (30, NOW, FIGURE)):
        before = replace(scene.frame, image=replace(scene.frame.image, index=index, timestamp_s=index / 30.0))
        scene.ask(Stage.LOCAL_MAP, sieve, before_the_wall(before, T_world_cam, figure), T_world_cam)
    figure = np.flatnonzero(in_box(scene.with_figure().frame, FIGURE))
    seen_twice = figure[scene.frame.keypoints.raw_px[figure, 0] < 295]  # Beside it, neighbouring pixels see the wall.
    motion = scene.ask(Stage.LOCAL_MAP, sieve)
    assert not motion.is_static[seen_twice].any()
    still = scene.sieve(past=False)
    scene.ask(Stage.LOCAL_MAP, still, replace(scene.frame, image=replace(scene.frame.image, timestamp_s=1.0)))
    assert scene.ask(Stage.LOCAL_MAP, still).is_static[seen_twice].all()


def test_more_agreeing_images_may_be_asked_for(scene: Scene) -> None:
    assert scene.ask(Stage.LOCAL_MAP, scene.sieve(min_agreeing=2)).is_static.all()
    motion = scene.ask(Stage.LOCAL_MAP, scene.sieve(min_agreeing=3))
    np.testing.assert_array_equal(motion.is_static, ~scene.inside)


@pytest.mark.parametrize(
    ("stage", "limit_px"), [(Stage.MOTION_MODEL, 2.0), (Stage.LOCAL_MAP, 3.0), (Stage.REFERENCE_KEYFRAME, 4.0)]
)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_what_left_its_line_goes_by_the_threshold_of_the_stage(
    scene: Scene, stage: Stage, limit_px: float, side: float
) -> None:
    """Shifted along the wall in the image, its depth still agrees: the line alone tells."""
    moved = scene.inside_and_matched()[::4]
    near = scene.ask(stage, scene.sieve(), scene.moved(moved, side * 0.97 * limit_px))
    assert near.is_static.all()
    far = scene.ask(stage, scene.sieve(), scene.moved(moved, side * 1.03 * limit_px))
    np.testing.assert_array_equal(far.is_static, without(scene, moved))


def test_along_its_line_a_point_is_free(scene: Scene) -> None:
    """What the line cannot tell is left to depth."""
    moved = scene.inside_and_matched()[::4]
    along = scene.normals(moved) @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    px = scene.frame.keypoints.px.copy()
    px[moved] += (10.0 * along).astype(np.float32)
    frame = replace(scene.frame, keypoints=replace(scene.frame.keypoints, px=px))
    assert scene.ask(Stage.MOTION_MODEL, scene.sieve(), frame).is_static.all()


def test_outside_the_boxes_nothing_is_judged(scene: Scene) -> None:
    moved = np.setdiff1d(scene.matches.keypoint, np.flatnonzero(scene.inside))
    assert scene.ask(Stage.MOTION_MODEL, scene.sieve(), scene.moved(moved, 9.0)).is_static.all()


def test_the_pose_that_is_given_draws_the_lines(scene: Scene) -> None:
    """With a pose that looks two degrees too low, the wall leaves its lines."""
    wrong = NOW @ se3.exp(np.array([0.0, 0.0, 0.0, 0.03, 0.0, 0.0]))
    motion = scene.ask(Stage.MOTION_MODEL, scene.sieve(), T_world_cam=wrong)
    assert motion.is_static[scene.inside_and_matched()].mean() < 0.05
    assert motion.is_static[~scene.inside].all()


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize(("outside", "inside", "off"), [(40, 30, False), (39, 30, True), (0, 20, True), (0, 19, False)])
def test_it_is_off_where_too_few_matches_would_stay(
    scene: Scene, stage: Stage, outside: int, inside: int, off: bool
) -> None:
    sieve = scene.sieve()
    everywhere = replace(FIGURE, x_max_px=BOX.x_max_px)
    scene.frame = before_the_wall(scene.frame, NOW, everywhere)
    keypoint, is_inside = scene.matches.keypoint, scene.inside[scene.matches.keypoint]
    chosen = np.concatenate((keypoint[~is_inside][:outside], keypoint[is_inside][:inside]))
    motion = scene.ask(stage, sieve, matches=scene.matches.keep(np.isin(keypoint, chosen)))
    np.testing.assert_array_equal(motion.is_static, np.ones(len(scene.frame), np.bool_) if off else ~scene.inside)
    assert motion.moving.any() == (not off)


def test_it_remembers_while_it_is_off(scene: Scene) -> None:
    """Or it would never be on again in a crowd."""
    sieve, nothing = scene.sieve(past=False), scene.matches.keep(scene.inside[scene.matches.keypoint])
    before = replace(scene.frame, image=replace(scene.frame.image, timestamp_s=1.0))
    assert not scene.ask(Stage.LOCAL_MAP, sieve, before, matches=nothing).moving.any()
    assert scene.ask(Stage.LOCAL_MAP, sieve).moving.any()
    assert scene.ask(Stage.LOCAL_MAP, sieve).is_static.all()


def test_it_is_off_while_relocalizing_and_needs_no_semantics_then(scene: Scene) -> None:
    class Never:
        def result(self) -> Semantics:
            raise AssertionError("awaited")

    sieve = scene.with_figure().sieve()
    motion = ask(sieve, Stage.RELOCALIZATION, scene.frame, scene.matches, Never(), np.eye(4), scene.small.map)
    assert motion.is_static.all()
    assert not motion.moving.any()


def test_where_nothing_may_move_nothing_does(scene: Scene) -> None:
    motion = scene.with_figure().ask(Stage.LOCAL_MAP, scene.sieve(), semantics=no_semantics().result())
    assert motion.is_static.all()
    assert not motion.moving.any()


def test_how_far_back_it_looks_is_configured(scene: Scene) -> None:
    """The history's tolerance reaches it: a wall that came 20 cm nearer passes for the same only if that is allowed."""
    for tolerance_m, stays in ((0.08, False), (0.3, True)):
        history = DepthHistoryConfig(tolerance_m=tolerance_m)
        sieve = scene.sieve(history=history)  # type: ignore[arg-type]
        nearer = before_the_wall(scene.frame, NOW, BOX, figure_m=2.8)
        motion = scene.ask(
            Stage.MOTION_MODEL, sieve, nearer, matches=scene.matches.keep(~scene.inside[scene.matches.keypoint])
        )
        np.testing.assert_array_equal(motion.is_static, np.ones(len(nearer), np.bool_) if stays else ~scene.inside)
