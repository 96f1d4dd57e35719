"""Learning: the loss falls, a resumed run goes on exactly, processes agree, and the file says what was learnt."""

import json
import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from examples import people_example

from stillroom.errors import ConfigError, MissingExtraError, WeightsError
from stillroom.presets.registry import configure
from stillroom.semantics.masks.pspnet import PspNetConfig
from stillroom_train.pspnet.evaluate import Overlap, called_person, overlap
from stillroom_train.pspnet.export.graph import Graph
from stillroom_train.pspnet.networks.registry import architecture
from stillroom_train.pspnet.networks.torch_network import torch_or_error
from stillroom_train.pspnet.pictures.batches import Batches
from stillroom_train.pspnet.recipe import Recipe, Variation

ROOT = Path(__file__).parents[2]
RECIPE = Recipe(steps=24, batch=2, crop=("65x65",), rate=1e-3, anchor=0.1, average=0.5, variation=Variation(0.9, 1.3))


@pytest.fixture
def torch():
    module = pytest.importorskip("torch", reason="torch is not installed; pip install 'stillroom[train]'")
    module.set_num_threads(1)
    return module


def batches() -> Batches:
    return Batches([people_example(seed) for seed in range(6)], RECIPE, seed=0)


def learner(backbone: str = "mobilenetv2"):
    from stillroom_train.pspnet.learner import Learner

    return Learner(architecture(backbone), RECIPE, steps_an_epoch=3, seed=0)


def test_the_loss_falls_and_the_file_says_what_torch_says(torch, tmp_path: Path) -> None:
    from stillroom_train.pspnet.export.network_file import write_onnx
    from stillroom_train.pspnet.networks.torch_network import enlarged

    learns, steps = learner(), batches()
    losses = [learns.learn(steps.at(step)) for step in range(RECIPE.steps)]
    assert np.mean(losses[-4:]) < 0.6 * np.mean(losses[:2])
    file = tmp_path / "pspnet.onnx"
    write_onnx(file, learns.architecture, learns.result(), half=False)

    network = PspNetConfig(model=file).build().reading.network
    blob = np.random.default_rng(0).uniform(-1, 1, (1, 3, 97, 129)).astype(np.float32)
    told = network._session.run(None, {"image": blob})[0]
    state = learns.network.state_dict()
    state.update({name: torch.from_numpy(value) for name, value in learns.result().items()})
    learns.network.load_state_dict(state)
    learns.network.eval()
    with torch.no_grad():
        expected = enlarged(learns.network(torch.from_numpy(blob))[0], learns.architecture).numpy()
    np.testing.assert_allclose(told, expected, atol=1e-4)


def test_a_resumed_run_is_the_run_that_was_not_stopped(torch, tmp_path: Path) -> None:
    steps = batches()
    whole = learner()
    for step in range(4):
        whole.learn(steps.at(step))
    first = learner()
    for step in range(2):
        first.learn(steps.at(step))
    first.store(tmp_path / "checkpoint.pt")
    second = learner()
    second.resume(tmp_path / "checkpoint.pt")
    assert second.step == 2
    for step in range(2, 4):
        second.learn(steps.at(step))
    for name, value in whole.result().items():
        np.testing.assert_array_equal(second.result()[name], value, err_msg=name)
    assert not np.array_equal(first.result()["backbone.00.weight"], whole.result()["backbone.00.weight"])


def test_what_cannot_be_resumed_from(torch, tmp_path: Path) -> None:
    (tmp_path / "broken.pt").write_bytes(b"nothing")
    for name in ("absent.pt", "broken.pt"):
        with pytest.raises(WeightsError, match="cannot be resumed from"):
            learner().resume(tmp_path / name)
    learner().store(tmp_path / "light.pt")
    with pytest.raises(WeightsError, match="is of mobilenetv2, not of resnet50"):
        learner("resnet50").resume(tmp_path / "light.pt")


def test_a_checkpoint_with_code_in_it_is_not_run(torch, tmp_path: Path) -> None:
    from stillroom_train.pspnet.networks.starts import checkpoint_weights

    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "sprung",))

    torch.save({"state_dict": {}, "meta": Trap()}, tmp_path / "trap.pth")
    with pytest.raises(WeightsError, match="checkpoint of weights alone"):
        checkpoint_weights(tmp_path / "trap.pth", architecture("resnet50"))
    assert not (tmp_path / "sprung").exists()


def test_schedules(torch) -> None:
    from dataclasses import replace

    from stillroom_train.pspnet.learner import Learner

    paper = Learner(architecture("mobilenetv2"), replace(RECIPE, schedule="step", epochs_a_step=2), 3, seed=0)
    rates = []
    for step in (0, 5, 6, 11, 12):
        paper.step = step
        rates.append(paper.rate)
    np.testing.assert_allclose(rates, [1e-3, 1e-3, 1e-4, 1e-4, 1e-5])
    cosine = Learner(architecture("mobilenetv2"), replace(RECIPE, steps=1000), 3, seed=0)
    cosine.step = 1000
    assert cosine.rate == pytest.approx(0.02 * 1e-3)


def test_without_torch_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'stillroom\[train\]'"):
        torch_or_error()


def test_overlap_counts_pixels() -> None:
    masks = [np.zeros((4, 4), np.uint8) for _ in range(3)]
    masks[0][:2], masks[1][:, :1] = 255, 255
    told = iter([np.arange(16).reshape(4, 4) < 4, masks[1] > 0, np.zeros((4, 4), bool)])
    found = overlap(lambda rgb: next(told), [(np.zeros((4, 4, 3), np.uint8), mask) for mask in masks])
    assert found == Overlap(mean=pytest.approx((0.5 + 1.0 + 1.0) / 3), total=pytest.approx(8 / 12), pictures=3)
    assert called_person(lambda rgb: rgb[..., 0] > 0, [np.eye(4, dtype=np.uint8)[..., None]] * 2) == 0.25


def a_teacher(path: Path) -> Path:
    """A network that calls red a person, all else background."""
    graph = Graph(half=False)
    weight = np.zeros((21, 3, 1, 1), np.float32)
    weight[15, 0], weight[0, 2] = 8.0, 8.0
    graph.add("Conv", ["image", graph.weight("weight", weight)], "logits", kernel_shape=[1, 1])
    path.write_bytes(graph.model("image", {"logits": 21}, {}).SerializeToString())
    return path


def write_people(folder: Path, count: int) -> None:
    for name in ("images", "masks"):
        (folder / name).mkdir(parents=True)
    for number in range(count):
        made = people_example(number)
        cv2.imwrite(str(folder / "images" / f"{number}.png"), made.rgb[..., ::-1])
        cv2.imwrite(str(folder / "masks" / f"{number}.png"), made.person)


def command(tmp_path: Path, *words: str, steps: int) -> list[str]:
    sets = [f"steps={steps}", "batch=2", "crop=65x65", "rate=0.001"]
    teacher = str(a_teacher(tmp_path / "t.onnx"))
    return [
        *words, "train", "pspnet", "--people", str(tmp_path / "people"), "--teacher", teacher,
        "--from", "nothing", "--out", str(tmp_path / "out"), "--threads", "1",
        *[part for each in sets for part in ("--set", each)],
    ]  # fmt: skip


def test_the_command_trains_resumes_and_exports(torch, tmp_path: Path, monkeypatch, capsys) -> None:
    from stillroom.cli.main import main

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    write_people(tmp_path / "people", 6)
    for steps in (2, 3):
        with pytest.raises(SystemExit) as left:
            main(command(tmp_path, steps=steps))
        assert left.value.code == 0
    assert "step 3: person IoU on 2 pictures held out" in capsys.readouterr().out
    log = [json.loads(line) for line in (tmp_path / "out" / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in log if "held_out" in line] == [2, 3]
    with pytest.raises(SystemExit) as left:
        main(["export", "pspnet", str(tmp_path / "out" / "checkpoint.pt"), "--out", str(tmp_path / "again.onnx")])
    assert left.value.code == 0
    trained, exported = (np.array(run(path)) for path in (tmp_path / "out" / "pspnet.onnx", tmp_path / "again.onnx"))
    np.testing.assert_array_equal(trained, exported)


def run(path: Path) -> np.ndarray:
    network = configure("pspnet-slam", overrides=[f"semantics.model={path}"]).semantics.build().reading.network
    return network.probabilities(people_example().rgb, 160, 120)


@pytest.mark.slow
def test_two_processes_learn_one_network(torch, tmp_path: Path) -> None:
    if not torch.distributed.is_available():
        pytest.skip("this torch has no distributed training")
    write_people(tmp_path / "people", 6)
    launched = [sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2", "--master-port", "29617", "-m"]
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT / "src")}
    said = subprocess.run(
        command(tmp_path, *launched, "stillroom.cli.main", steps=3),
        env=environment, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert said.returncode == 0, said.stderr[-2000:]
    log = [json.loads(line) for line in (tmp_path / "out" / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in log if "held_out" in line] == [3], "one process writes"
    assert np.isfinite(run(tmp_path / "out" / "pspnet.onnx")).all()


@pytest.mark.parametrize(("device", "says"), [("tpu", "cpu or cuda"), ("cuda", "no such GPU")])
def test_a_device_that_is_not_there(device: str, says: str, torch, tmp_path: Path) -> None:
    from stillroom_train.pspnet.train import Plan, Weights, train

    if device == "cuda" and torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    with pytest.raises(ConfigError, match=says):
        train(Plan(tmp_path, tmp_path, recipe=RECIPE, device=device), [people_example()], Weights({}), print)
