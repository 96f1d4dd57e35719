"""`stillroom export pspnet`."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from stillroom.geometry.arrays import F32

MEGABYTE = 1e6


def export_pspnet(
    checkpoint: Annotated[
        Path, typer.Argument(metavar="FILE", help="A checkpoint of 'stillroom train pspnet', or OpenMMLab's.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="Write the network here.")] = Path(
        "pspnet.onnx"
    ),
    backbone: Annotated[str, typer.Option(metavar="NAME", help="mobilenetv2 or resnet50.")] = "mobilenetv2",
    spared: Annotated[
        float,
        typer.Option("--thin", metavar="SHARE", help="Prune this share of the work, such as 0.25."),
    ] = 0.0,
    pictures: Annotated[
        list[Path] | None,
        typer.Option(
            "--pictures",
            metavar="DIR",
            help="Images for choosing channels: images/ (every fifth left out), or a sequence; repeatable.",
        ),
    ] = None,
    full: Annotated[bool, typer.Option("--full", help="Store weights as 32-bit numbers, not as 16.")] = False,
) -> None:
    """Export a trained network as an ONNX file, which runs without torch.

    To use it: --set semantics.kind=pspnet --set semantics.model=pspnet.onnx

        stillroom export pspnet results/pspnet/checkpoint.pt --out pspnet.onnx
        stillroom export pspnet results/pspnet/checkpoint.pt --thin 0.25 --pictures person_masks --pictures empty_room
        stillroom export pspnet downloaded.pth --backbone resnet50
    """
    from stillroom.cli.output import print_lines
    from stillroom_train.pspnet.export.network_file import write_onnx
    from stillroom_train.pspnet.export.thin import thin
    from stillroom_train.pspnet.networks.registry import architecture
    from stillroom_train.pspnet.networks.starts import checkpoint_weights
    from stillroom_train.pspnet.pictures.inputs import seen_by

    network = architecture(backbone)
    weights: Mapping[str, F32] = checkpoint_weights(checkpoint, network)
    if spared:
        network, weights = thin(network, weights, spared, seen_by(network, pictures or ()))
    write_onnx(out, network, weights, half=not full)
    print_lines([f"{out}: PSPNet on {backbone}, {out.stat().st_size / MEGABYTE:.1f} MB"])
