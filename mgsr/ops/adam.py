"""Adam over packed parameters, fused: one call of the kernel updates all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch

from mgsr.errors import CheckpointError, TensorError
from mgsr.native import _adam
from mgsr.native.cuda.adam import Group, judge, make_group, update
from mgsr.native.cuda.launcher import launcher_for
from mgsr.native.structs import AdamParameter
from mgsr.ops.arrays import plain


def any_bad(tensors: Sequence[torch.Tensor]) -> torch.Tensor:
    """Return whether any value is not finite or exceeds 1e19, beyond which squares overflow float32.

    The result is [] bool on the tensors' device; the call does not synchronise.
    """
    launcher = launcher_for(tensors[0])
    if launcher is not None:
        return judge(launcher, [plain(tensor) for tensor in tensors])
    # A dot product reads the numbers once, and is finite only if all of them are.
    squares = [flat @ flat for flat in (tensor.detach().reshape(-1) for tensor in tensors)]
    return ~torch.isfinite(torch.stack(squares).sum())


def step_together(optimizers: Sequence[FusedAdam], bad: torch.Tensor | None = None) -> None:
    """Take a step of all optimisers on one device, on a GPU in one launch.

    bad [] bool, on a GPU: whether all gradients count as zero (see `any_bad`).
    """
    launcher = launcher_for(next(iter(optimizers[0].params.values())))
    if launcher is None:
        for optimizer in optimizers:
            optimizer.step_on_processor(optimizer.due())
        return
    update(launcher, [group for optimizer in optimizers for group in optimizer.groups(optimizer.due())], bad)


class FusedAdam:
    """Adam (Kingma and Ba 2015) for parameters with one row per splat, where splats come and go.

    params: name to leaf tensor [N, ...], float32, on one device; all have the same N. The attribute `params` holds the
        current leaves, which `keep` and `extend` replace by new ones.
    lrs: name to learning rate, one for each parameter.
    lr_scales: name to tensor [...] of the shape of a row, with a factor of the rate for each column. For spherical
        harmonics it is [K, 3], with 1 for the first band and 1/20 for the others.
    betas, epsilon: as in the paper; 1e-15 suits gradients as small as those of splats.

    A parameter without a gradient keeps its values and its step count. New rows start with zero moments and share the
    step count of the old ones. A NaN gradient makes only its own number NaN. The result has the same bytes for any
    number of threads.
    """

    def __init__(
        self,
        params: Mapping[str, torch.Tensor],
        lrs: Mapping[str, float],
        *,
        lr_scales: Mapping[str, torch.Tensor] | None = None,
        betas: tuple[float, float] = (0.9, 0.999),
        epsilon: float = 1e-15,
    ) -> None:
        if set(params) != set(lrs):
            raise TensorError(f"lrs: expected a rate for each of {sorted(params)}, got {sorted(lrs)}")
        self.params: dict[str, torch.Tensor] = {}
        self.lrs = dict(lrs)
        self.betas, self.epsilon = betas, epsilon
        self._scales = {
            name: scale.detach().to(params[name].device).contiguous().reshape(-1)
            for name, scale in (lr_scales or {}).items()
        }
        self._first: dict[str, torch.Tensor] = {}
        self._second: dict[str, torch.Tensor] = {}
        # For each parameter, the values and the two moments as [rows, columns].
        self._packed: dict[str, AdamParameter] = {}
        self._groups: dict[str, Group] = {}
        self._steps = dict.fromkeys(params, 0)
        for name, param in params.items():
            self._adopt(name, param, torch.zeros_like(param.detach()), torch.zeros_like(param.detach()))

    def step(self) -> None:
        """Update every parameter that has a gradient, in place."""
        step_together([self])

    def set_lrs(self, lrs: Mapping[str, float]) -> None:
        """Change all learning rates from the next step on. Names of other parameters are ignored.

        Raises TensorError if the rate of a parameter is missing.
        """
        if not self.params.keys() <= lrs.keys():
            raise TensorError(f"set_lrs: expected a rate for each of {sorted(self.params)}, got {sorted(lrs)}")
        self.lrs = {name: lrs[name] for name in self.params}

    def keep(self, rows: torch.Tensor) -> None:
        """Keep the rows of a mask [N] bool, or those of an index [M] int64 in its order (a row may come twice).

        Parameters become new leaves without gradients; moments are selected alike.
        """
        for name, param in self.params.items():
            self._adopt(name, param.detach()[rows], self._first[name][rows], self._second[name][rows])

    def extend(self, rows: Mapping[str, torch.Tensor]) -> None:
        """Append rows [M, ...] to every parameter, with zero moments. Parameters become new leaves.

        Raises TensorError for other names, or different numbers of rows.
        """
        if set(rows) != set(self.params):
            raise TensorError(f"rows: expected {sorted(self.params)}, got {sorted(rows)}")
        if len({new.shape[0] for new in rows.values()}) > 1:
            counts = {name: new.shape[0] for name, new in rows.items()}
            raise TensorError(f"rows: expected the same number for each name, got {counts}")
        for name, new in rows.items():
            new = new.detach()
            zeros = torch.zeros_like(new)
            moments = (torch.cat([m[name], zeros]) for m in (self._first, self._second))
            self._adopt(name, torch.cat([self.params[name].detach(), new]), *moments)

    def replace(self, name: str, values: torch.Tensor) -> None:
        """Overwrite one parameter [N,...] in place, and zero its moments (for an opacity reset)."""
        with torch.no_grad():
            self.params[name].copy_(values)
        self._first[name].zero_()
        self._second[name].zero_()

    def state_dict(self) -> dict[str, Any]:
        """Return moments, step counts and rates, which with `params` are the complete state of the optimiser.

        Tensors are not copied.
        """
        return {
            "first": dict(self._first),
            "second": dict(self._second),
            "steps": dict(self._steps),
            "lrs": dict(self.lrs),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore what `state_dict` returned, for parameters of the same names and shapes.

        Raises CheckpointError if they differ.
        """
        for key in ("first", "second"):
            came = {name: tuple(t.shape) for name, t in state[key].items()}
            expected = {name: tuple(t.shape) for name, t in self.params.items()}
            if came != expected:
                raise CheckpointError(f"optimiser state: expected moments of {expected}, got {came}")
        devices = {name: param.device for name, param in self.params.items()}
        self._first = {name: t.to(devices[name], copy=True) for name, t in state["first"].items()}
        self._second = {name: t.to(devices[name], copy=True) for name, t in state["second"].items()}
        self._steps, self.lrs = dict(state["steps"]), dict(state["lrs"])
        for name in self.params:
            self._pack(name)

    def _adopt(self, name: str, param: torch.Tensor, first: torch.Tensor, second: torch.Tensor) -> None:
        """Take a parameter [N,...] with its moments under a name, as a contiguous float32 leaf.

        Raises TensorError for another dtype, layout or number of dimensions.
        """
        leaf = param if param.is_leaf and param.requires_grad else param.detach().requires_grad_()
        if leaf.dtype != torch.float32 or not leaf.is_contiguous() or leaf.ndim == 0:
            came = f"{leaf.dtype} {[*leaf.shape]}"
            raise TensorError(f"{name}: expected a contiguous float32 tensor [N, ...], got {came}; call .contiguous()")
        scale = self._scales.get(name)
        if scale is not None and scale.numel() != leaf[:1].numel() and leaf.shape[0]:
            raise TensorError(f"lr_scales: expected {[*leaf.shape[1:]]} for {name}, got {scale.numel()} numbers")
        self.params[name], self._first[name], self._second[name] = leaf, first.contiguous(), second.contiguous()
        self._pack(name)

    def _pack(self, name: str) -> None:
        tensors = (self.params[name].detach(), self._first[name], self._second[name])
        values, first, second = (tensor.view(tensor.shape[0], -1) if tensor.numel() else tensor for tensor in tensors)
        self._packed[name] = AdamParameter(
            values=values, first=first, second=second, column_scales=self._scales.get(name)
        )
        self._groups.pop(name, None)

    def due(self) -> list[tuple[str, torch.Tensor]]:
        """Return the names of the parameters that a step changes, with their gradients [N,...]."""
        return [(name, p.grad.contiguous()) for name, p in self.params.items() if p.grad is not None and p.numel()]

    def step_on_processor(self, due: Sequence[tuple[str, torch.Tensor]]) -> None:
        """Take one step on the CPU; due: names and gradients [N,...] (see `due`)."""
        batch = _adam.AdamBatch(*self.betas, self.epsilon)
        for name, gradients in due:
            self._steps[name] += 1
            parameter = self._packed[name]
            batch.add(parameter, gradients.view(parameter.values.shape), self.lrs[name], self._steps[name])
        batch.update()

    def groups(self, due: Sequence[tuple[str, torch.Tensor]]) -> list[tuple[Group, torch.Tensor, float, int]]:
        """Count one step, and return the GPU kernel's arguments for it; due: names and gradients [N,...]."""
        for name, _ in due:
            self._steps[name] += 1
        return [(self._group(name), gradients, self.lrs[name], self._steps[name]) for name, gradients in due]

    def _group(self, name: str) -> Group:
        """Return the parameter as a struct for the GPU's kernel."""
        group = self._groups.get(name)
        if group is None:
            group = self._groups[name] = make_group(self._packed[name], self.betas, self.epsilon)
        return group
