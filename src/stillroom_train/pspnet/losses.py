"""Loss functions."""

from typing import TYPE_CHECKING

from stillroom_train.pspnet.networks.steps import Architecture
from stillroom_train.pspnet.networks.torch_network import enlarged, torch_or_error
from stillroom_train.pspnet.recipe import Recipe

if TYPE_CHECKING:
    from torch import Tensor

PERSON = 15


def loss_of(
    scores: "tuple[Tensor, Tensor | None]", classes: "Tensor", weight: "Tensor", network: Architecture, recipe: Recipe
) -> "Tensor":
    """Return the loss of a batch.

    Args:
        scores: Those of the network, and of its auxiliary head.
        classes: Probabilities (N, classes, h, w) at a fourth of the size.
        weight: 1 where they are known (N, h, w).
        network: Says how scores are enlarged to labels.
        recipe: Weights of the parts.
    """
    main, auxiliary = scores
    large = enlarged(main, network)
    loss = _cross_entropy(large, classes, weight)
    if recipe.overlap:
        loss = loss + recipe.overlap * _missing_overlap(large.softmax(1)[:, PERSON], classes[:, PERSON], weight)
    if recipe.auxiliary and auxiliary is not None:
        loss = loss + recipe.auxiliary * _cross_entropy(enlarged(auxiliary, network), classes, weight)
    return loss


def _cross_entropy(large: "Tensor", classes: "Tensor", weight: "Tensor") -> "Tensor":
    """Return the mean of −Σ p log q over pixels that are known."""
    each = -(classes * large.log_softmax(1)).sum(1)
    mean: Tensor = (each * weight).sum() / weight.sum().clamp(min=1.0)
    return mean


def _missing_overlap(said: "Tensor", true: "Tensor", weight: "Tensor") -> "Tensor":
    """Return 1 − intersection over union of the person's shares, mean over pictures with a person in them."""
    torch = torch_or_error()
    both = (torch.minimum(said, true) * weight).sum((1, 2))
    either = (torch.maximum(said, true) * weight).sum((1, 2))
    present = ((true * weight).sum((1, 2)) > 1.0).float()
    mean: Tensor = ((1.0 - both / either.clamp(min=1.0)) * present).sum() / present.sum().clamp(min=1.0)
    return mean
