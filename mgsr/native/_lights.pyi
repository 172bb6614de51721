from collections.abc import Sequence

from torch import Tensor

from mgsr.native.structs import UnlitGradients

def isas() -> list[str]: ...
def isa() -> str: ...
def set_isa(name: str) -> None: ...
def threads() -> int: ...
def set_threads(n: int) -> None: ...
def add_reflection(
    transmitted: Tensor,
    weight: Tensor,
    own: Tensor | None,
    environment: Tensor | None,
    color: Tensor,
    reflected: Tensor,
) -> None: ...
def add_reflection_vjp(
    v_color: Tensor, reflected: Tensor, weight: Tensor, before: Sequence[Tensor | None], out: Sequence[Tensor]
) -> None: ...
def light_up(
    unlit: Tensor, alpha: Tensor, background: Tensor, shading: Tensor, offset: float, image: Tensor
) -> None: ...
def light_up_vjp(
    v_image: Tensor,
    background: Tensor,
    shading: Tensor,
    offset: float,
    add_alpha: Tensor | None,
    out: UnlitGradients,
) -> None: ...
