from collections.abc import Sequence

from numpy import ndarray

def isas() -> list[str]: ...
def isa() -> str: ...
def set_isa(name: str) -> None: ...
def threads() -> int: ...
def set_threads(n: int) -> None: ...
def search(
    images: Sequence[ndarray],
    cameras: ndarray,
    view: int,
    neighbours: Sequence[int],
    start_depth: ndarray,
    start_normal: ndarray,
    range: tuple[float, float],
    settings: Sequence[float],
    seed: int,
    depth: ndarray,
    normal: ndarray,
    score: ndarray,
) -> None: ...
def judge(
    images: Sequence[ndarray],
    cameras: ndarray,
    view: int,
    neighbours: Sequence[int],
    depth: ndarray,
    normal: ndarray,
    range: tuple[float, float],
    settings: Sequence[float],
    score: ndarray,
) -> None: ...
