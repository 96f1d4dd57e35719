"""`stillroom export pspnet`."""

from pathlib import Path
from typing import Annotated

import typer

MEGABYTE = 1e6


def export_pspnet(
    checkpoint: Annotated[
        Path, typer.Argument(metavar="FILE", help="A checkpoint of 'stillroom train pspnet', or OpenMMLab's.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="Write the network here.")] = Path(
        "pspnet.onnx"
    ),
    backbone: Annotated[str, typer.Option(metavar="NAME", help="mobilenetv2 or resnet50.")] = "mobilenetv2",
    full: Annotated[bool, typer.Option("--full", help="Store weights as 32-bit numbers, not as 16.")] = False,
) -> None:
    """Turn what was trained into an ONNX file, which runs without torch.

    To use it: --set semantics.kind=pspnet --set semantics.model=pspnet.onnx

        stillroom export pspnet results/pspnet/checkpoint.pt --out pspnet.onnx
        stillroom export pspnet downloaded.pth --backbone resnet50
    """
    from stillroom.cli.output.tables import print_lines
    from stillroom.training.export.network_file import write_onnx
    from stillroom.training.networks.registry import architecture
    from stillroom.training.networks.starts import checkpoint_weights

    network = architecture(backbone)
    write_onnx(out, network, checkpoint_weights(checkpoint, network), half=not full)
    print_lines([f"{out}: PSPNet on {backbone}, {out.stat().st_size / MEGABYTE:.1f} MB"])
