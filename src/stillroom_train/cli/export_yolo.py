"""`stillroom export yolo`."""

from pathlib import Path
from typing import Annotated

import typer

MEGABYTE = 1e6


def export_yolo(
    cfg: Annotated[Path, typer.Argument(metavar="CFG", help="The network, as darknet writes it.")],
    weights: Annotated[Path, typer.Argument(metavar="WEIGHTS", help="Its weights.")],
    names: Annotated[Path, typer.Option("--names", metavar="FILE", help="Its class names, one a line.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="Write the network here.")] = Path(
        "yolo.onnx"
    ),
    about: Annotated[str, typer.Option(metavar="TEXT", help="Origin and licence, stored in the file.")] = "",
) -> None:
    """Export a detector of darknet's, cfg and weights, as an ONNX file.

    YOLO-Fastest's networks and those of YOLO v3 can be read so. To use it: --set semantics.model=yolo.onnx with
    --method oc-slam.

        stillroom export yolo my.cfg my.weights --names my.names --out my.onnx
    """
    from stillroom.cli.output import print_lines
    from stillroom.errors import WeightsError
    from stillroom_train.darknet.onnx_file import convert_files

    model = convert_files(cfg, weights, names, about)
    try:
        out.write_bytes(model)
    except OSError as error:
        raise WeightsError(f"{out}: cannot be written ({error.strerror}); choose another --out") from error
    print_lines([f"{out}: {len(model) / MEGABYTE:.1f} MB"])
