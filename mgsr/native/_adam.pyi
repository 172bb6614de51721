from torch import Tensor

def isas() -> list[str]: ...
def isa() -> str: ...
def set_isa(name: str) -> None: ...
def threads() -> int: ...
def set_threads(n: int) -> None: ...

class AdamBatch:
    def __init__(self, beta1: float, beta2: float, epsilon: float) -> None: ...
    def add(
        self,
        values: Tensor,
        gradients: Tensor,
        first: Tensor,
        second: Tensor,
        column_scales: Tensor | None,
        rate: float,
        step: int,
    ) -> None: ...
    def update(self) -> None: ...

def adam_double(
    value: float,
    gradient: float,
    first: float,
    second: float,
    rate: float,
    beta1: float,
    beta2: float,
    epsilon: float,
    root_scale: float,
) -> tuple[float, float, float]: ...
