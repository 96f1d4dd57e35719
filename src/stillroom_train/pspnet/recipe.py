"""How a network learns: recipes by name."""

from dataclasses import dataclass, replace

from stillroom.errors import ConfigError
from stillroom_train.pspnet.networks.steps import Architecture

SMALLEST = 33
"""Least side of a crop [px]: three pixels of the scores."""


@dataclass(frozen=True)
class Variation:
    """How pictures are varied.

    Attributes:
        smallest, largest: Limits of the longer side of a picture as the network sees it, in sides of the crop.
        rotation_deg: Largest rotation to either side.
        colors: Whether brightness, contrast, saturation and white balance change, and now and then all colour goes.
        blurs: Share of pictures that are blurred as by focus or motion.
        noisy: Share of pictures with a cheap camera's noise.
        strangers: Share of empty rooms into which a person from another picture is pasted.
    """

    smallest: float = 0.6
    largest: float = 2.0
    rotation_deg: float = 10.0
    colors: bool = True
    blurs: float = 0.2
    noisy: float = 0.2
    strangers: float = 0.6


@dataclass(frozen=True)
class Recipe:
    """How a network learns.

    Attributes:
        steps: Batches in all.
        batch: Pictures in a batch.
        crop: What the network sees, such as "241x321" (rows × columns); of several, each batch has one in turn.
        rate: Learning rate of the backbone.
        head_rate: Learning rate of the heads, in rates of the backbone's.
        schedule: "step" (× 0.1 every `epochs_a_step` epochs) or "cosine" (after a short rise, down to a fiftieth).
        epochs_a_step: For "step".
        weight_decay: Towards zero, as a part of the loss (paper).
        anchor: Towards the weights at the start, per step and unit of learning rate: what the pictures do not show,
            animals say, shall not be forgotten.
        auxiliary: Weight of the auxiliary loss.
        overlap: Weight of the loss of the person's overlap (1 − soft intersection over union).
        average: Share of the running mean of the weights that stays at each step; 0 keeps none. The mean is what is
            told as the result.
        stay: Share of the weights at the start in the result. Half the way between two trained networks often is better
            than either, and forgets less (Wortsman et al., CVPR 2022); not for networks with batch norm.
        shares: How often a batch's picture is one of people, of an empty room, of the own domain.
        variation: How pictures are varied.
    """

    steps: int = 700
    batch: int = 6
    crop: tuple[str, ...] = ("321x321",)
    rate: float = 3e-5
    head_rate: float = 2.0
    schedule: str = "cosine"
    epochs_a_step: int = 30
    weight_decay: float = 0.0
    anchor: float = 10.0
    auxiliary: float = 0.4
    overlap: float = 0.5
    average: float = 0.995
    stay: float = 0.5
    shares: tuple[float, float, float] = (0.7, 0.1, 0.2)
    variation: Variation = Variation()

    @property
    def crops(self) -> list[tuple[int, int]]:
        """Rows and columns of each crop.

        Raises:
            ConfigError: One is not written as it should be.
        """
        found = []
        for text in self.crop:
            rows, times, columns = text.partition("x")
            if not times or not rows.isdecimal() or not columns.isdecimal() or min(int(rows), int(columns)) < SMALLEST:
                raise ConfigError(f"crop is '{text}'; write it like 241x321, with sides of {SMALLEST} or more")
            found.append((int(rows), int(columns)))
        return found

    def check(self) -> None:
        """Refuse impossible values.

        Raises:
            ConfigError: Names the key.
        """
        for key in ("steps", "batch", "rate", "head_rate", "epochs_a_step"):
            if getattr(self, key) <= 0:
                raise ConfigError(f"{key} is {getattr(self, key)}; it must be above 0")
        if not self.crops:
            raise ConfigError("crop names no size; write it like 241x321")
        if self.schedule not in ("step", "cosine"):
            raise ConfigError(f"schedule is '{self.schedule}'; it must be 'step' or 'cosine'")
        for key in ("average", "stay"):
            if not 0.0 <= getattr(self, key) < 1.0:
                raise ConfigError(f"{key} is {getattr(self, key)}; it must be at least 0 and below 1")
        if min(self.shares) < 0 or sum(self.shares) <= 0:
            raise ConfigError(f"shares is {self.shares}; none may be negative, and one must be above 0")


PAPER = Recipe(
    steps=12_000,
    batch=8,
    crop=("481x641",),
    rate=1e-4,
    head_rate=1.0,
    schedule="step",
    weight_decay=0.005,
    anchor=0.0,
    overlap=0.0,
    average=0.0,
    stay=0.0,
    variation=Variation(strangers=0.0),
)
"""PSPNet-SLAM IV: batch 8, 640×480, learning rate 1e-4 × 0.1 every 30 epochs, weight decay 0.005."""

PRACTICAL = Recipe(crop=("257x257", "241x321", "321x241"))
"""What fits into an hour or two of one CPU core, from weights that are trained already."""

PRESETS = {"paper": PAPER, "practical": PRACTICAL}


def preset(name: str, **changes: object) -> Recipe:
    """Return a recipe by name, with some values changed; None leaves a value as it is.

    Raises:
        ConfigError: There is no such recipe, or a value is impossible.
    """
    if name not in PRESETS:
        raise ConfigError(f"recipe is '{name}'; known: {', '.join(PRESETS)}")
    recipe = replace(PRESETS[name], **{key: value for key, value in changes.items() if value is not None})  # type: ignore[arg-type]
    recipe.check()
    return recipe


def fitting(recipe: Recipe, network: Architecture) -> Recipe:
    """Return a recipe whose crops have the sides, or the next smaller ones, that a network's scores cover exactly.

    They are multiples of its stride, and one more where the corners of scores lie on corner pixels. Labels and enlarged
    scores then are of one size.
    """
    more = 1 if network.corners else 0
    sides = [[(side - more) // network.stride * network.stride + more for side in crop] for crop in recipe.crops]
    return replace(recipe, crop=tuple(f"{rows}x{columns}" for rows, columns in sides))
