"""The loss of a training step: a sum of named terms."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import torch
from torch import Tensor


class Loss:
    """A sum of terms.

    found [T]: the values of the terms that `evaluate` computed, in the order of their names; others: terms [] that
    torch differentiates, by name. The sum itself is found only when it is asked for.
    """

    def __init__(self, found: Tensor, names: Sequence[str], others: dict[str, Tensor]) -> None:
        self._found = found
        self._names = names
        self._others = others

    def plus(self, name: str, term: Tensor) -> Loss:
        """Return the loss with one more term []."""
        return Loss(self._found, self._names, self._others | {name: term})

    def backward(self) -> None:
        """Accumulate the sum's gradients in the leaves that it depends on."""
        roots = [self._found, *self._others.values()]
        torch.autograd.backward(roots, [_ones(root.shape, root.device) for root in roots])

    @property
    def value(self) -> Tensor:
        """Return the sum [], through which gradients flow."""
        return sum(self._others.values(), self._found.sum())

    @property
    def values(self) -> Tensor:
        """Return all terms' values [T], without gradients."""
        found = self._found.detach()
        return (
            torch.cat([found, *(term.detach().reshape(1) for term in self._others.values())]) if self._others else found
        )

    @property
    def terms(self) -> dict[str, Tensor]:
        """Return the terms [] by name, without gradients."""
        return dict(zip([*self._names, *self._others], self.values.unbind(), strict=True))


@cache
def _ones(shape: torch.Size, device: torch.device) -> Tensor:
    return torch.ones(shape, device=device)
