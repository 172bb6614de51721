"""Time budgets: a run is planned to give nearly the best result of the given time.

The budget first chooses the size of the photographs, once they are read. It then times an iteration of each stage, and
chooses the place on the line of settings (`mgsr.budget.line`). From then on the settings are fixed, and the lengths of
the stages follow the clock.

The time of surface extraction can neither be adjusted nor be predicted well. The surface is therefore extracted before
the rendering branch is fully trained. That branch then trains until only time for the report is left; this last stage
can end at any iteration. The surface's refinement can end after any round. It improves the surface more than training
of the same length.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from mgsr.budget import costs
from mgsr.budget.line import JUST_ABOVE_DRAFT, SettingsLine
from mgsr.config import (
    Branches,
    Config,
    GaussianConfig,
    Growth,
    MeshConfig,
    Reflection,
    SurfelConfig,
)
from mgsr.data.cost_factors import CostFactors
from mgsr.training.stage_scheduler import FINISH, StageLength

SCALES = (1.0, 0.71, 0.5, 0.35, 0.25)  # sizes of the photographs that may be chosen
TOO_SMALL = 1.05  # times the budget; where the shortest plan takes longer, the budget is too small
RATIOS = (0.05, 50.0)  # a machine's slowness that a single step may tell
DRIFTS = (0.1, 10.0)  # a change of speed that a single reading of the clock may tell
KEPT_DRIFT, LATEST_DRIFT = 0.7, 0.3  # weights of the earlier and the latest drift in their mean
HALVINGS = 12  # of the interval of places in the search for a plan
MESH_STEP = 0.25  # between two places that are tried for the surface once training has ended
MESH_RESERVE = 0.15  # share of the surface's expected time that is reserved then


class TimeBudget:
    """The time budget of `config`, counted from the zero of `clock`, in seconds.

    on_gpu: whether training runs on a GPU, whose speed does not show the CPU's speed.
    place: the place on the line of settings; None until it is chosen.
    scale: the scale of the training photographs; None until it is chosen.
    refined: the planned share of the refinement's full time.
    """

    def __init__(self, config: Config, clock: Callable[[], float], on_gpu: bool = False) -> None:
        assert config.time_budget is not None
        self.seconds, self.options = config.time_budget, config.expert.budget
        self.line = SettingsLine(config)
        self._most_stereo = config.expert.start.stereo.max_pixels
        self.on_gpu = on_gpu
        self.place: float | None = None
        self.scale: float | None = None
        self.planned: dict[str, float] = {}
        self.least = 0.0
        self.refined = 1.0
        self._cut = False  # whether the refinement ended early, so that its time is not representative
        self._mesh = MeshConfig()
        self._clock, self._earlier = clock, 0.0
        self._slowness: float | None = None
        self._drift = self._latest = 1.0
        self._costs: dict[str, float] = {}
        self._probed: dict[str, int] = {}
        self._weights: dict[str, float] = {}
        self._floors: dict[str, int] = {}
        self._ceilings: dict[str, int] = {}
        self._open = ""
        self._opened = 0.0
        self._recent: deque[tuple[float, int]] = deque(maxlen=self.options.readings)

    @property
    def spent(self) -> float:
        """Return the seconds of the run so far, including those before a resume."""
        return self._earlier + self._clock()

    @property
    def slowness(self) -> float:
        """Return the present time of this machine as a multiple of the reference machine's."""
        return (self._slowness or 1.0) * self._drift

    @property
    def stereo_pixels(self) -> int:
        """Return the number of pixels that the stereo of whole scenes can search in its share of the time."""
        affordable = self.options.stereo_share * self.seconds / costs.STEREO * 1e6
        return max(1, min(self._most_stereo, round(affordable)))

    @property
    def too_small(self) -> bool:
        """Return whether even the shortest plan was expected to exceed the budget."""
        return self.least > TOO_SMALL * self.seconds

    def learn(self, reference: float, seconds: float) -> None:
        """Update the machine's slowness by a step that took `seconds`, against `reference` on the reference machine."""
        ratio = min(max(seconds / reference, RATIOS[0]), RATIOS[1])
        self._slowness = ratio if self._slowness is None else (self.slowness * ratio) ** 0.5
        self._drift = self._latest = 1.0

    def choose_scale(self, factors: CostFactors) -> float:
        """Return the largest size of the photographs at which the preset draft fits; the smallest if none."""
        draft = self.line.at(0.0)
        for scale in SCALES:
            smaller = _scaled(factors, scale)
            if smaller.pixels < self.options.min_pixels and self.scale is not None:
                break
            self.scale = scale
            start = self.options.start_reserve * costs.start_cost(smaller, self.stereo_pixels)
            before = start + reference_training(smaller, draft)
            if self.spent + self.slowness * before + self._after(smaller, draft.mesh) <= self._aim:
                break
        assert self.scale is not None
        return self.scale

    def choose_place(self, factors: CostFactors, measured: Mapping[str, float], splats: Mapping[str, int]) -> float:
        """Return the place on the line at which the plan fills the remaining time.

        measured: the seconds of one iteration of each stage, in order. splats: the number of splats of each branch in
        that measurement.
        """
        self._factors, self._costs, self._probed = factors, dict(measured), dict(splats)
        if not self.on_gpu:
            reference = {name: costs.iteration_cost(name, factors, splats) for name in measured}
            self.learn(sum(reference.values()), sum(measured.values()))
        low, high = self.options.lowest, self.options.highest
        self.least = self.spent + self._total(self.line.at(low), reserve=0.0)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            fits = self.spent + self._total(self.line.at(middle)) <= self._aim
            low, high = (middle, high) if fits else (low, middle)
        self.place, self.refined = low, 1.0
        if low < JUST_ABOVE_DRAFT:
            share = self._refinable(self.line.at(JUST_ABOVE_DRAFT))
            if share >= self.options.min_refined:
                self.place, self.refined = JUST_ABOVE_DRAFT, share
        self._settle()
        return self.place

    def length(self, stages: Sequence[StageLength], index: int, splats: Mapping[str, int]) -> int:
        """Return the total number of iterations of the stage, at least one more than the completed ones.

        splats: the number of splats of each branch.
        """
        stage, now, period = stages[index], self.spent, self.options.period
        if stage.name != self._open:
            self._open, self._opened = stage.name, now
            self._recent.clear()
        if stage.iterations - stage.iteration > period and stage.iteration % period:
            return stage.iterations
        if self._recent and stage.iteration > self._recent[-1][1] + period:
            self._recent.clear()  # a model selection repeated iterations in between
        self._recent.append((now, stage.iteration))
        each = self._present(stage.name, splats)
        left = self._end(stages, index) - now
        iterations = max(stage.iteration + max(1, round(left / each)), self._floors.get(stage.name, 0))
        return min(iterations, self._ceilings.get(stage.name, iterations))

    def mesh_settings(self) -> MeshConfig:
        """Choose the best settings of the surface, up to the planned ones, that still fit with the least refinement."""
        assert self.place is not None
        lowest, place, least = self.options.lowest, self.place, min(self.refined, self.options.min_refined)
        self._drift = max(self._drift, self._latest)  # training ends soon after the machine has slowed down
        while place > lowest and self.spent + self._after(self._factors, self._mesh, MESH_RESERVE, least) > self._aim:
            place = max(lowest, place - MESH_STEP)
            self._mesh = self.line.at(place).mesh
        return self._mesh

    def learn_surface(self, surface: float, judging: float) -> None:
        """Update the machine's slowness by the seconds that the surface, and its scores and pictures, took."""
        if not self._cut:
            self.learn(costs.mesh_cost(self._factors, self._mesh, refined=1.0), surface)
        self.learn(costs.judging_cost(self._factors), judging)

    def go_on(self) -> bool:
        """Return whether there is time for another round of refining the surface."""
        rest = costs.judging_cost(self._factors) + costs.closing_cost(self._factors)
        fits = self.spent + self.slowness * (costs.round_cost(self._factors, self._mesh) + rest) < self._aim
        self._cut |= not fits
        return fits

    def room(self, splats: Mapping[str, int]) -> int:
        """Return about how many iterations the stage FINISH will have.

        splats: by branch.
        """
        left = self._aim - self.slowness * costs.closing_cost(self._factors) - self.spent
        return max(0, int(left / self._expected(FINISH, splats)))

    def state(self) -> dict[str, Any]:
        """Return the budget's state for a checkpoint."""
        return {
            "spent": self.spent,
            "place": self.place,
            "scale": self.scale,
            "refined": self.refined,
            "planned": self.planned,
            "least": self.least,
            "slowness": self.slowness,
            "costs": self._costs,
            "probed": self._probed,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore what `state` returned: the seconds spent, and the settings that were chosen then."""
        self._earlier = state["spent"]
        self.place, self.scale, self.refined = state["place"], state["scale"], state["refined"]
        self.planned, self.least = dict(state["planned"]), state["least"]
        self._slowness = state["slowness"]
        self._costs, self._probed = dict(state["costs"]), dict(state["probed"])

    def take_up(self, factors: CostFactors) -> None:
        """Set after `restore` what `choose_place` would have set."""
        self._factors = factors
        self._settle()

    @property
    def settings(self) -> Config:
        """Return the settings of the chosen place."""
        assert self.place is not None
        return self.line.at(self.place)

    @property
    def _aim(self) -> float:
        return self.options.aim * self.seconds

    def _settle(self) -> None:
        """Derive each stage's planned, least and largest length from the chosen place.

        Training beyond the largest length roughens the surface; the last stage gets the remaining time.
        """
        chosen, options = self.settings, self.options
        least, most = self.line.at(options.lowest), self.line.at(options.highest)
        self._mesh = chosen.mesh
        self._weights = {name: self._stage(name, chosen) for name in self._costs}
        self._floors = {name: min(_iterations(chosen, name), _iterations(least, name)) for name in self._costs}
        self._ceilings = {name: _iterations(most, name) for name in self._costs}
        if not self.planned:
            surface = self.slowness * costs.mesh_cost(self._factors, chosen.mesh, self.refined)
            closing = self.slowness * costs.closing_cost(self._factors)
            judging = self.slowness * costs.judging_cost(self._factors)
            training = max(self._aim - self.spent - surface - judging - closing, sum(self._weights.values()))
            self.planned = {
                "before": self.spent,
                "train": training,
                "mesh": surface,
                "evaluate": judging,
                "report": closing,
            }

    def _total(self, config: Config, reserve: float | None = None, refined: float = 1.0) -> float:
        """Return the seconds that these settings take from the first iteration on (see `_after`)."""
        training = sum(self._stage(name, config) for name in self._costs)
        return training + self._after(self._factors, config.mesh, reserve, refined)

    def _refinable(self, config: Config) -> float:
        """Return the share of the refinement's time that these settings leave for it, 0..1; 0 without refinement."""
        whole = self.slowness * costs.refinement_cost(self._factors, config.mesh)
        left = self._aim - self.spent - self._total(config, refined=0.0)
        return min(left / whole, 1.0) if whole else 0.0

    def _stage(self, name: str, config: Config) -> float:
        splats = _splats(name, self._factors, config)
        return _work(config, name) * self._expected(name, splats)

    def _expected(self, name: str, splats: Mapping[str, int]) -> float:
        """Return the expected seconds of one iteration: as measured, but scaled to this number of splats."""
        like = name if name in self._costs else list(self._costs)[-1]
        reference = costs.iteration_cost(like, self._factors, self._probed)
        return self._costs[like] * costs.iteration_cost(name, self._factors, splats) / reference

    def _present(self, name: str, splats: Mapping[str, int]) -> float:
        """Return the current seconds per iteration, and update the machine's drift from the expected speed."""
        expected = self._expected(name, splats)
        (first, start), (last, done) = self._recent[0], self._recent[-1]
        if len(self._recent) < 3:
            return expected * self._drift
        each = max((last - first) / (done - start), 1e-6)
        if not self.on_gpu and name in self._costs:
            self._latest = min(max(each / expected, DRIFTS[0]), DRIFTS[1])
            self._drift = KEPT_DRIFT * self._drift + LATEST_DRIFT * self._latest
        return each

    def _end(self, stages: Sequence[StageLength], index: int) -> float:
        """Return the time at which the stage should end: its share of the time until the surface must begin."""
        if stages[index].name == FINISH:
            return self._aim - self.slowness * costs.closing_cost(self._factors)
        assert self.place is not None
        weights = [self._weights[stage.name] for stage in stages[index:] if stage.name != FINISH]
        surface_begins = self._aim - self._after(self._factors, self._mesh)
        return self._opened + (surface_begins - self._opened) * weights[0] / sum(weights)

    def _after(
        self, factors: CostFactors, mesh: MeshConfig, reserve: float | None = None, refined: float | None = None
    ) -> float:
        """Return the seconds reserved for the steps after training.

        refined: the share of the refinement's time, None for the planned one. reserve: the reserved share of the
        surface's time in case it takes longer, None for the option. The refinement needs no reserve, because it can
        end early.
        """
        reserve = self.options.reserve if reserve is None else reserve
        surface = (1 + reserve) * (costs.surface_cost(factors, mesh) + costs.judging_cost(factors))
        refinement = (self.refined if refined is None else refined) * costs.refinement_cost(factors, mesh)
        return self.slowness * (surface + refinement + costs.closing_cost(factors))


def _scaled(factors: CostFactors, scale: float) -> CostFactors:
    return replace(factors, pixels=factors.pixels * scale**2)


def _iterations(config: Config, stage: str) -> int:
    """Return the iterations that the settings plan for a stage."""
    train = config.train
    if stage == "warmup_surfels":
        return train.warmup.surfel_iterations
    if stage == "warmup_gaussians":
        return train.warmup.gaussian_iterations
    return round(train.mutual.iterations * train.paper.iterations_factor)


def _work(config: Config, stage: str) -> int:
    """Return the iterations of a stage, including those of a selection's rejected candidates."""
    iterations, train = _iterations(config, stage), config.train
    if stage != "warmup_gaussians" or train.gaussians.reflection is not Reflection.AUTO:
        return iterations
    return iterations + config.expert.budget.rejected * min(
        train.model_selection.iterations, round((1 - train.model_selection.start) * iterations)
    )


def _splats(stage: str, factors: CostFactors, config: Config) -> dict[str, int]:
    """Return the number of splats by branch, in the middle of a stage."""
    surfels, gaussians = costs.usual_settings(factors, config)
    branches: dict[str, SurfelConfig | GaussianConfig] = {"surfels": surfels, "gaussians": gaussians}
    if config.train.branches is not Branches.BOTH:
        branches = {config.train.branches.value: branches[config.train.branches.value]}
    most = {name: branch.densify.max_count for name, branch in branches.items()}
    if "gaussians" in most and gaussians.densify.by is Growth.ERROR:
        most["gaussians"] = min(most["gaussians"], costs.usual_count(gaussians.max_start, factors))
    if not stage.startswith("warmup"):
        return most
    return {name: (branch.max_start + most[name]) // 2 for name, branch in branches.items()}


def reference_training(factors: CostFactors, config: Config) -> float:
    """Return the seconds of training on the reference machine."""
    return sum(
        _work(config, name) * costs.iteration_cost(name, factors, _splats(name, factors, config))
        for name in _stages(config)
    )


def _stages(config: Config) -> tuple[str, ...]:
    """Return the stages that a run with these settings has."""
    if config.train.branches is Branches.BOTH:
        return ("warmup_surfels", "warmup_gaussians", "mutual")
    return ("warmup_surfels" if config.train.branches is Branches.SURFELS else "warmup_gaussians", "alone")
