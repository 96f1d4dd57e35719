"""`stillroom train-vocabulary`."""

from pathlib import Path
from typing import Annotated

import typer


def train_vocabulary(
    sequences: Annotated[
        list[str], typer.Argument(metavar="SEQUENCE...", help="Folders, archives, known names, or synthetic:empty.")
    ],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="Write the vocabulary here.")],
    every: Annotated[int, typer.Option(min=1, metavar="N", help="Use every N-th image.")] = 5,
    branching: Annotated[int, typer.Option(min=2, max=255, metavar="K", help="Children of a node.")] = 10,
    depth: Annotated[int, typer.Option(min=1, metavar="L", help="Levels of the tree, at most.")] = 5,
    least: Annotated[
        int, typer.Option(min=2, metavar="N", help="A node with fewer descriptors than this is not split.")
    ] = 20,
    grow: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Grow this vocabulary on the sequences instead of starting from nothing."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of all random choices.")] = 0,
) -> None:
    """Make a vocabulary of places from sequences.

    Place recognition compares images by the words of a vocabulary. One is shipped; another, trained on images of your
    own, may distinguish similar places better. A text file next to it names the training data. To use it: --set
    places.vocabulary=FILE.

        stillroom train-vocabulary synthetic:empty my_lab --out lab.vocabulary
    """
    from rich.progress import Progress

    from stillroom.cli.output import STDERR, print_lines, show_log
    from stillroom.cli.warmup import ensure_warm
    from stillroom.datasets.open import open_dataset
    from stillroom.datasets.recording import rendered
    from stillroom.errors import VocabularyError
    from stillroom.features.places.growth import GrowthConfig
    from stillroom.features.places.vocabulary import load_vocabulary
    from stillroom_train.vocabulary import CARD, make, read_source

    show_log()
    if not out.absolute().parent.is_dir():
        raise VocabularyError(f"{out}: no such folder; make {out.absolute().parent} first")
    start = None if grow is None else load_vocabulary(grow)
    datasets = [open_dataset(sequence) for sequence in sequences]
    ensure_warm(STDERR, any(rendered(dataset) is not None for dataset in datasets))
    with Progress(console=STDERR, disable=not STDERR.is_terminal) as bar:
        task = bar.add_task("reading", total=sum(-(-len(dataset) // every) for dataset in datasets))
        sources = [read_source(dataset, every, told=lambda: bar.advance(task)) for dataset in datasets]
    config = GrowthConfig(branching=branching, depth=depth, min_descriptors=least, seed=seed)
    made = make(sources, config, start)
    made.save(out)
    size_mb = out.stat().st_size / 1e6
    n_images = sum(len(source.images) for source in sources)
    print_lines(
        [
            f"{made.vocabulary.n_words} words from {n_images} images, {size_mb:.2f} MB",
            f"written: {out} and {out.name}{CARD}",
        ]
    )
