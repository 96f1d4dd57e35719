"""`stillroom map info`."""

from typing import TYPE_CHECKING

from stillroom.cli.map.check import MapPath

if TYPE_CHECKING:
    from stillroom.storage.stored import StoredMap


def info(path: MapPath) -> None:
    """Say what a map file holds: the runs that made it, keyframes, points, camera.

    stillroom map info room.stillmap
    """
    from stillroom.cli.output.tables import print_lines, print_table
    from stillroom.data.map import submaps
    from stillroom.storage.opening import inspect
    from stillroom.storage.reader import count_images, load_map

    version = inspect(path).version
    stored, n_images = load_map(path), count_images(path)
    world, camera = stored.world, stored.camera
    n_alive, n_all = len(world.alive_keyframes()), len(world.keyframes)
    n_points, n_seen = int(world.points.is_alive.sum()), int((world.keypoints.point >= 0).sum())
    megabytes = path.stat().st_size * 1e-6
    n_submaps = len(submaps.unjoined(world))
    print_lines(
        [
            f"{path}: map format {version}, {megabytes:.1f} MB",
            f"{n_alive} keyframes ({n_all - n_alive} more were culled), {n_points} points seen {n_seen} times; "
            f"{n_submaps} sub-map{'' if n_submaps == 1 else 's'}, {len(world.loop_edges)} loops closed",
            f"camera: {camera.width}×{camera.height}, fx {camera.fx:g}, fy {camera.fy:g}, cx {camera.cx:g}, "
            f"cy {camera.cy:g}; {world.scales.count} pyramid levels of {world.scales.factor:g}",
            f"images of {n_images} keyframes, for dense maps" if n_images else "no images of keyframes",
        ]
    )
    header = "run", "sequence", "method", "started", "Stillroom", "keyframes", "frames", "images"
    print_table(header, _rows(stored), n_words=5)


def _rows(stored: "StoredMap") -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    alive = stored.world.alive_keyframes()
    edges = [session.first_keyframe for session in stored.sessions]
    ends = [*edges[1:], len(stored.world.keyframes)]
    for number, (session, first, end) in enumerate(zip(stored.sessions, edges, ends, strict=True)):
        frames = [frame.image_index for frame in stored.frames if frame.session == number]
        span = f"{min(frames)} to {max(frames)}" if frames else "none"
        n_keyframes = int(((alive >= first) & (alive < end)).sum())
        words = str(number), session.sequence, session.method, session.started, session.stillroom
        rows.append((*words, str(n_keyframes), str(len(frames)), span))
    return rows
