"""`stillroom run --export-masks`: the masks are what Python is told, what pictures show, and what reads back."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from rgbd_folder import write_rgbd_folder

import stillroom as sr
from stillroom.cli.main import main
from stillroom.semantics.mask_files import MaskFilesConfig
from stillroom.viz.recorder import draw_verdict

N_FRAMES = 8


def grown_mask(image):
    """Stand in for a network: a mask that grows from image to image."""
    mask = np.zeros((image.height, image.width), np.bool_)
    mask[100:300, 100 : 120 + 10 * image.index] = True
    return sr.Semantics(image.height, image.width, mask=mask)


def test_files_python_and_pictures_agree(tmp_path: Path, monkeypatch) -> None:
    folder = tmp_path / "my_room"
    write_rgbd_folder(sr.open_dataset(f"synthetic:walking,frames={N_FRAMES},fps=10"), folder)
    dataset = sr.open_dataset(str(folder))
    inputs = tmp_path / "inputs"
    inputs.mkdir()
    for image in dataset:
        mask = grown_mask(image).mask.astype(np.uint8)
        cv2.imwrite(str(inputs / f"{image.name}.png"), mask)
    settings = ["semantics.kind=mask-files", f"semantics.folder={inputs}"]
    seen = {}

    class Observer:
        def on_frame(self, tracked, semantics, result):
            assert result.motion.moving is tracked.motion.moving  # the array that pictures are drawn from
            plain, nobody = tracked.frame.image.rgb, np.zeros(0, np.bool_)
            nothing = sr.Semantics(*plain.shape[:2])
            drawn = draw_verdict(plain, np.zeros((0, 2)), nobody, nobody, nothing, result.motion.moving, scale=1.0)
            seen[tracked.frame.image.name] = result.motion.moving, np.any(drawn != plain, axis=2)

    with sr.Slam("dynaslam-n", dataset.camera, settings=settings, observers=[Observer()]) as slam:
        for image in dataset:
            slam.process(image)

    monkeypatch.chdir(tmp_path)
    chosen = [word for setting in settings for word in ("--set", setting)]
    arguments = ["run", str(folder), "--method", "dynaslam-n", "--pictures", "0", "--export-masks", "masks"]
    with pytest.raises(SystemExit) as left:
        main([*arguments, *chosen])
    assert not left.value.code
    written = {path.stem: path for path in (tmp_path / "masks").iterdir()}
    assert written.keys() == {path.stem for path in (folder / "rgb").iterdir()} == seen.keys()
    reader = MaskFilesConfig(tmp_path / "masks").build()
    for image in dataset:
        moving, tinted = seen[image.name]
        pixels = cv2.imread(str(written[image.name]), cv2.IMREAD_UNCHANGED)
        assert pixels.dtype == np.uint8
        assert set(np.unique(pixels)) <= {0, 255}
        np.testing.assert_array_equal(pixels == 255, moving)
        np.testing.assert_array_equal(reader(image).mask, moving)
        assert moving.any()
        assert tinted[moving].mean() > 0.95  # a pixel may have the tint's own colour
