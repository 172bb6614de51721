from numpy import ndarray
from torch import Tensor

def isas() -> list[str]: ...
def isa() -> str: ...
def set_isa(name: str) -> None: ...
def threads() -> int: ...
def set_threads(n: int) -> None: ...
def forward(coeffs: Tensor, means: Tensor, center: Tensor, degree: int, rgb: Tensor) -> None: ...
def backward(
    coeffs: Tensor,
    means: Tensor,
    center: Tensor,
    degree: int,
    rgb: Tensor,
    v_rgb: Tensor,
    v_coeffs: Tensor,
    v_means: Tensor | None,
) -> None: ...
def harmonics_double(
    coeffs: ndarray,
    means: ndarray,
    center: ndarray,
    degree: int,
    rgb: ndarray,
    v_rgb: ndarray | None,
    v_coeffs: ndarray | None,
    v_means: ndarray | None,
) -> None: ...
