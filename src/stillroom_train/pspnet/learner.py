"""Training of a network, step by step, with exact checkpoints."""

import math
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stillroom.errors import WeightsError
from stillroom.geometry.arrays import F32
from stillroom_train.pspnet.losses import loss_of
from stillroom_train.pspnet.networks.steps import Architecture
from stillroom_train.pspnet.networks.torch_network import arrays, torch_network, torch_or_error
from stillroom_train.pspnet.pictures.batches import Batch
from stillroom_train.pspnet.recipe import Recipe

RISE_STEPS = 100
LOWEST = 0.02
LARGEST_GRADIENT = 5.0


class Learner:
    """A network, its optimiser, the weights that it started from, and the running mean of its weights."""

    def __init__(
        self, architecture: Architecture, recipe: Recipe, steps_an_epoch: int, seed: int, device: str = "cpu"
    ) -> None:
        """Start from random weights.

        Args:
            architecture: The network.
            recipe: How it learns.
            steps_an_epoch: For the schedule by epochs.
            seed: Of the random weights, and of dropout.
            device: As torch calls it.

        Raises:
            MissingExtraError: torch is not installed.
        """
        self._torch = torch_or_error()
        self._torch.manual_seed(seed)
        self.architecture = architecture
        self.recipe = recipe
        self.step = 0
        self._seed = seed
        self._steps_an_epoch = max(steps_an_epoch, 1)
        self._device = device
        self.network = torch_network(architecture).to(device, memory_format=self._torch.channels_last)
        self._called: Any = self.network
        backbone: list[Any] = []
        heads: list[Any] = []
        for name, value in self.network.named_parameters():
            (backbone if name.startswith("backbone.") else heads).append(value)
        groups = [{"params": backbone, "times": 1.0}, {"params": heads, "times": recipe.head_rate}]
        self._optimizer = self._torch.optim.Adam(groups, lr=recipe.rate, weight_decay=recipe.weight_decay)
        self._remember()

    def begin_with(self, weights: Mapping[str, F32], start: Mapping[str, F32] | None = None) -> None:
        """Take over weights; those that are not named stay as they are.

        Args:
            weights: By name.
            start: What counts as the start, where these come from an earlier run; otherwise they do.
        """
        state = self.network.state_dict()
        state.update({name: self._torch.from_numpy(value.copy()) for name, value in weights.items()})
        self.network.load_state_dict(state)
        self._remember()
        for name, value in (start or {}).items():
            self._start[name] = self._torch.from_numpy(value.copy()).to(self._device)

    def in_parallel(self) -> None:
        """Share gradients with the other processes from now on."""
        inner = self._torch.nn.parallel.DistributedDataParallel
        self._called = inner(self.network)

    def learn(self, batch: Batch) -> float:
        """Take a step; return the loss."""
        torch, recipe = self._torch, self.recipe
        # What is dropped depends on the step alone, so that a resumed run drops the same.
        torch.manual_seed(self._seed * 1_000_003 + self.step)
        for group in self._optimizer.param_groups:
            group["lr"] = self.rate * group["times"]
        self._called.train()
        rgb, classes, weight = (torch.from_numpy(x).to(self._device) for x in (batch.rgb, batch.classes, batch.weight))
        loss = loss_of(self._called(self._normalised(rgb)), classes, weight, self.architecture, recipe)
        self._optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), LARGEST_GRADIENT)
        self._optimizer.step()
        self._hold_back()
        self._average()
        self.step += 1
        return float(loss.detach())

    @property
    def rate(self) -> float:
        """The learning rate of the next step."""
        recipe = self.recipe
        if recipe.schedule == "step":
            return float(recipe.rate * 0.1 ** (self.step // self._steps_an_epoch // recipe.epochs_a_step))
        rise = min((self.step + 1) / RISE_STEPS, 1.0)
        fall = 0.5 * (1.0 + math.cos(math.pi * min(self.step / recipe.steps, 1.0)))
        return recipe.rate * rise * max(fall, LOWEST)

    def result(self) -> dict[str, F32]:
        """Return the weights that are told as the result: the running mean, if kept, drawn back to the start."""
        latest = {name: value.detach() for name, value in self.network.named_parameters()} | self._mean
        stay = 0.0 if any(conv.norm for conv in self.architecture.convolutions) else self.recipe.stay
        return arrays(self.network) | {
            name: value.lerp(self._start[name], stay).cpu().numpy().copy() for name, value in latest.items()
        }

    def store(self, path: Path) -> None:
        """Write a checkpoint; an older file is replaced atomically."""
        state = {
            "state_dict": self.network.state_dict(), "mean": self._mean, "start": self._start, "step": self.step,
            "result": {name: self._torch.from_numpy(value) for name, value in self.result().items()},
            "optimizer": self._optimizer.state_dict(), "architecture": self.architecture.name, "seed": self._seed,
        }  # fmt: skip
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(path.name + ".part")
        self._torch.save(state, part)
        part.replace(path)

    def resume(self, path: Path) -> None:
        """Resume from a checkpoint of `store`.

        Raises:
            WeightsError: The file is absent, or of another network.
        """
        try:
            state = self._torch.load(path, map_location=self._device, weights_only=True)
        except (OSError, RuntimeError, EOFError, pickle.UnpicklingError) as error:
            raise WeightsError(f"{path}: cannot be resumed from ({str(error).splitlines()[0]})") from error
        if state.get("architecture") != self.architecture.name:
            raise WeightsError(f"{path}: is of {state.get('architecture')}, not of {self.architecture.name}")
        self.network.load_state_dict(state["state_dict"])
        self._optimizer.load_state_dict(state["optimizer"])
        self._mean, self._start, self.step = state["mean"], state["start"], int(state["step"])

    def _normalised(self, rgb: Any) -> Any:
        mean, std = (
            self._torch.tensor(values, device=self._device).view(1, 3, 1, 1)
            for values in (self.architecture.mean, self.architecture.std)
        )
        return ((rgb - mean) / std).to(memory_format=self._torch.channels_last)

    def _remember(self) -> None:
        """Store the weights as the start."""
        self._start = {name: value.detach().clone() for name, value in self.network.named_parameters()}
        self._mean = {name: value.clone() for name, value in self._start.items()} if self.recipe.average else {}

    def _hold_back(self) -> None:
        """Pull the weights towards the start."""
        pull = self.rate * self.recipe.anchor
        if pull == 0.0:
            return
        with self._torch.no_grad():
            for name, value in self.network.named_parameters():
                value.lerp_(self._start[name], pull)

    def _average(self) -> None:
        """Update the running mean; quickly at first, while it is near the initial weights."""
        stays = min(self.recipe.average, (1 + self.step) / (10 + self.step))
        with self._torch.no_grad():
            for name, value in self.network.named_parameters():
                if name in self._mean:
                    self._mean[name].lerp_(value, 1.0 - stays)
