"""Training: examples, a recipe, weights to start from; a checkpoint, a log and an ONNX file come of it."""

import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from stillroom.errors import ConfigError
from stillroom.geometry.arrays import F32, U8, Bool
from stillroom.semantics.masks.pspnet import pspnet
from stillroom_train.pspnet.evaluate import overlap
from stillroom_train.pspnet.export.network_file import write_onnx
from stillroom_train.pspnet.learner import Learner
from stillroom_train.pspnet.networks.registry import architecture
from stillroom_train.pspnet.networks.torch_network import torch_or_error
from stillroom_train.pspnet.pictures.batches import Batches
from stillroom_train.pspnet.pictures.example import PEOPLE, Example
from stillroom_train.pspnet.pictures.gather import PERSON, held_out
from stillroom_train.pspnet.recipe import Recipe, fitting

CHECKPOINT, LOG, MODEL = "checkpoint.pt", "log.jsonl", "pspnet.onnx"


@dataclass(frozen=True)
class Plan:
    """What is trained, from what, and how often is looked at it.

    Attributes:
        out: Folder for the checkpoint, the log and the ONNX file.
        backbone: "mobilenetv2" or "resnet50".
        recipe: How it learns.
        seed: Seed of all random choices.
        device: As torch calls it; "cuda" under torchrun is the process's own.
        log_every: Steps between lines of the log.
        store_every: Steps between checkpoints.
        look_every: Steps between looks at the pictures that are held out; 0 looks only at the end.
        look_px: Longer side of the input at which those are seen [px].
        people: Folder of the pictures of people, for those that are held out.
    """

    out: Path
    people: Path
    backbone: str = "mobilenetv2"
    recipe: Recipe = field(default_factory=Recipe)
    seed: int = 0
    device: str = "cpu"
    log_every: int = 10
    store_every: int = 50
    look_every: int = 0
    look_px: int = 640


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights to start from.

    Attributes:
        now: By name; what is not named is random.
        start: Where an earlier run began whose weights these are; None where they are the start themselves.
    """

    now: Mapping[str, F32]
    start: Mapping[str, F32] | None = None


Told = Callable[[Mapping[str, Any]], None]
"""Gets each line of the log."""


def train(plan: Plan, examples: list[Example], weights: Weights, told: Told) -> None:
    """Train a network, going on where a checkpoint lies in the folder; write its ONNX file at the end.

    Under torchrun each process learns from batches of its own, and the first one writes.

    Args:
        plan: What is trained.
        examples: What it learns from.
        weights: To start from.
        told: Gets each line of the log.

    Raises:
        ConfigError: A value of the recipe is impossible, or the device is not there.
        MissingExtraError: torch is not installed.
        WeightsError: The checkpoint is of another network.
    """
    plan.recipe.check()
    _check_device(plan.device)
    process, processes = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
    network = architecture(plan.backbone)
    people = sum(example.kind == PEOPLE for example in examples)
    device = f"cuda:{os.environ.get('LOCAL_RANK', '0')}" if plan.device == "cuda" else plan.device
    learner = Learner(network, plan.recipe, people // (plan.recipe.batch * processes), plan.seed, device)
    learner.begin_with(weights.now, weights.start)
    checkpoint = plan.out / CHECKPOINT
    if checkpoint.exists():
        learner.resume(checkpoint)
    if processes > 1:
        _join(plan.device)
        learner.in_parallel()
    log = _Log(plan.out / LOG, told) if process == 0 else None
    _learn(learner, Batches(examples, fitting(plan.recipe, network), plan.seed, process), plan, log)
    if log is not None:
        learner.store(checkpoint)
        log(look(learner, plan))
    if processes > 1:
        torch_or_error().distributed.destroy_process_group()


def look(learner: Learner, plan: Plan) -> dict[str, Any]:
    """Write the ONNX file of what is learnt so far, and return how well it does on what is held out."""
    path = plan.out / MODEL
    write_onnx(path, learner.architecture, learner.result(), about={"steps": str(learner.step)})
    seen = overlap(segmenting(path, plan.look_px), held_out(plan.people))
    return {"step": learner.step, "held_out": asdict(seen), "look_px": plan.look_px}


def segmenting(path: Path | None, longer_side_px: int) -> Callable[[U8], Bool]:
    """Return a function from a picture to where an ONNX file of PSPNet sees people; None is the shipped one."""
    network = pspnet(path, [PERSON], longer_side_px)
    return lambda rgb: network.probabilities(rgb, rgb.shape[1], rgb.shape[0])[0] >= 0.5


def _learn(learner: Learner, batches: Batches, plan: Plan, log: "_Log | None") -> None:
    losses: list[float] = []
    began = time.perf_counter()
    while learner.step < plan.recipe.steps:
        rate = learner.rate
        losses.append(learner.learn(batches.at(learner.step)))
        if log is None:
            continue
        if learner.step % plan.log_every == 0:
            log({"step": learner.step, "loss": sum(losses) / len(losses), "rate": rate,
                 "elapsed_s": round(time.perf_counter() - began, 1)})  # fmt: skip
            losses.clear()
        if learner.step % plan.store_every == 0:
            learner.store(plan.out / CHECKPOINT)
        if plan.look_every and learner.step % plan.look_every == 0:
            log(look(learner, plan))


def _check_device(device: str) -> None:
    if device not in ("cpu", "cuda"):
        raise ConfigError(f"device is '{device}'; it must be cpu or cuda")
    if device == "cuda" and not torch_or_error().cuda.is_available():
        raise ConfigError("device is cuda, but torch finds no such GPU here; use cpu")


def _join(device: str) -> None:
    """Join the other processes that torchrun started."""
    torch = torch_or_error()
    if not torch.distributed.is_available():
        raise ConfigError("this torch cannot train on several processes; start it without torchrun")
    if device == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")))
    torch.distributed.init_process_group("nccl" if device == "cuda" else "gloo")


class _Log:
    """Lines of JSON, in a file and told at once."""

    def __init__(self, path: Path, told: Told) -> None:
        self._path = path
        self._told = told
        path.parent.mkdir(parents=True, exist_ok=True)

    def __call__(self, line: Mapping[str, Any]) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
        self._told(line)
