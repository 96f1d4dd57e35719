"""`stillroom train pspnet`."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stillroom.cli.arguments import Settings

if TYPE_CHECKING:
    from stillroom_train.pspnet.networks.steps import Architecture
    from stillroom_train.pspnet.pictures.example import Example
    from stillroom_train.pspnet.pictures.gather import Sources
    from stillroom_train.pspnet.train import Weights

PEOPLE = "person_masks"
TEACHER, BACKBONE = "deeplabv3_mobilenetv2_voc.onnx", "mobilenetv2_voc_backbone.npz"
SCRATCH = "nothing"


People = Annotated[
    Path | None, typer.Option(metavar="DIR", help="Pictures of people: images/ and masks/. \\[default: person_masks]")
]
Rooms = Annotated[
    list[Path] | None,
    typer.Option("--room", metavar="DIR", help="An RGB-D sequence without people; repeatable."),
]
Domain = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="An RGB-D sequence with people, labelled by the teacher."),
]
Every = Annotated[int, typer.Option(min=1, metavar="N", help="Use every N-th frame of sequences.")]
Start = Annotated[
    Path | None,
    typer.Option(
        "--from",
        metavar="FILE",
        help="Start from a checkpoint, of ours or OpenMMLab's; 'nothing': random weights. "
        "\\[default for mobilenetv2: the teacher's backbone and head]",
    ),
]
TeacherFile = Annotated[
    Path | None, typer.Option(metavar="FILE", help=f"ONNX file of the teacher. \\[default: {TEACHER}]")
]
Out = Annotated[
    Path, typer.Option(metavar="DIR", help="Folder for checkpoint, log and ONNX file; resumes from a checkpoint in it.")
]
Threads = Annotated[int, typer.Option(min=0, metavar="N", help="CPU threads; 0: all.")]
LookEvery = Annotated[
    int,
    typer.Option(min=0, metavar="N", help="Steps between validations on the pictures held out; 0: at the end only."),
]


def train_pspnet(
    people: People = None,
    rooms: Rooms = None,
    domain: Domain = None,
    domain_frames: Annotated[str, typer.Option(metavar="A:B", help="Its frames.")] = "280:561",
    every: Every = 3,
    backbone: Annotated[str, typer.Option(metavar="NAME", help="mobilenetv2 or resnet50.")] = "mobilenetv2",
    start: Start = None,
    teacher: TeacherFile = None,
    recipe: Annotated[str, typer.Option(metavar="NAME", help="practical, or paper.")] = "practical",
    settings: Settings = None,
    out: Out = Path("results/pspnet"),
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of all random choices.")] = 0,
    device: Annotated[str, typer.Option(metavar="NAME", help="cpu or cuda.")] = "cpu",
    threads: Threads = 0,
    look_every: LookEvery = 0,
) -> None:
    """Train PSPNet, which segments people.

    Trains on pictures with true masks, of which every fifth is held out, and on a teacher's labels of all 21 classes.
    Needs torch, which the extra 'train' installs. A stopped run resumes from the last checkpoint; on several processes
    or GPUs it runs under torchrun.

        stillroom train pspnet --room empty_room --domain rgbd_bonn_crowd
        stillroom train pspnet --recipe paper --backbone resnet50
        torchrun --nproc-per-node 2 -m stillroom.cli.main train pspnet
    """
    from stillroom.cli.output import show_log
    from stillroom.config import with_overrides
    from stillroom_train.pspnet.networks.registry import architecture
    from stillroom_train.pspnet.networks.torch_network import torch_or_error
    from stillroom_train.pspnet.pictures.gather import Sources
    from stillroom_train.pspnet.recipe import preset
    from stillroom_train.pspnet.train import Plan, train

    show_log()
    network = architecture(backbone)
    chosen = with_overrides(preset(recipe), settings or ())
    if str(start) == SCRATCH:
        chosen = replace(chosen, stay=0.0, anchor=0.0)  # no pull back to random weights
    chosen.check()
    processes = int(os.environ.get("WORLD_SIZE", "1"))
    torch_or_error().set_num_threads(threads or max((os.cpu_count() or 1) // processes, 1))
    home = people or _sequence(PEOPLE)
    teacher_file = teacher or _model(TEACHER)
    weights = _start(start, network, teacher_file)
    sources = Sources(home, tuple(rooms or ()), domain, _frames(domain_frames), every)
    examples = _examples(sources, teacher_file)
    plan = Plan(out, home, backbone, chosen, seed, device, look_every=look_every)
    train(plan, examples, weights, _line)


def _start(start: Path | None, network: "Architecture", teacher: Path) -> "Weights":
    """Return the weights to start from."""
    from stillroom.errors import WeightsError
    from stillroom_train.pspnet.networks.starts import backbone_weights, checkpoint_weights, deeplab_head
    from stillroom_train.pspnet.train import Weights

    if start is not None and str(start) == SCRATCH:
        return Weights({})
    if start is not None:
        return Weights(checkpoint_weights(start, network, "mean"), checkpoint_weights(start, network, "start"))
    if network.name == "mobilenetv2":
        return Weights(backbone_weights(_model(BACKBONE), network) | deeplab_head(teacher, network))
    raise WeightsError(
        f"{network.name} starts from a checkpoint: 'stillroom download pspnet-r50', then --from FILE; "
        f"or --from {SCRATCH}"
    )


def _examples(sources: "Sources", teacher: Path) -> "list[Example]":
    from stillroom.cli.output import say
    from stillroom.data.locations import cache_folder
    from stillroom_train.pspnet.pictures.gather import gather
    from stillroom_train.pspnet.pictures.teacher import Teacher

    def report(kind: str, done: int, total: int) -> None:
        if done == total:
            say(f"{kind}: {total} pictures")

    return gather(sources, Teacher(teacher, cache_folder() / "teacher"), report)


def _line(entry: Mapping[str, Any]) -> None:
    from stillroom.cli.output import print_lines

    if "held_out" in entry:
        seen = entry["held_out"]
        print_lines(
            [
                f"step {entry['step']}: person IoU on {seen['pictures']} pictures held out: {seen['mean']:.3f} mean, "
                f"{seen['total']:.3f} total (at {entry['look_px']} px)"
            ]
        )
        return
    print_lines([f"step {entry['step']}: loss {entry['loss']:.4f}, rate {entry['rate']:.2g}, {entry['elapsed_s']} s"])


def _frames(text: str) -> tuple[int, int]:
    """Return first and last frame of `A:B`, which is without B as everywhere."""
    from stillroom.errors import ConfigError

    first, colon, end = text.partition(":")
    if not colon or not first.isdecimal() or not end.isdecimal() or int(first) >= int(end):
        raise ConfigError(f"--domain-frames is '{text}'; write it like 280:561")
    return int(first), int(end) - 1


def _sequence(name: str) -> Path:
    from stillroom.data.locations import sequence_path
    from stillroom.errors import DatasetError

    found = sequence_path(name)
    if found is None:
        raise DatasetError(f"no folder {name} with pictures of people; name one with --people, or set STILLROOM_DATA")
    return found


def _model(name: str) -> Path:
    from stillroom.data.locations import model_path
    from stillroom.errors import WeightsError

    found = model_path(name)
    if found is None:
        raise WeightsError(f"no {name}; set STILLROOM_MODELS to the folder that holds it")
    return found
