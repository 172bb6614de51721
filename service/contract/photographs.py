"""The photographs of a job and their cameras, as its check found them."""

from __future__ import annotations

from pydantic import BaseModel, Field

Place = tuple[float, float, float]


class CheckedPhotograph(BaseModel):
    """A photograph and its camera, in the capture's frame."""

    name: str
    center: Place = Field(description="The camera's position.")
    direction: Place = Field(description="The unit direction in which it looks.")
    up: Place = Field(description="The unit direction in which the upper side of the image lies.")
    angles: tuple[float, float] = Field(description="Degrees that it sees across and down.")
    residual: float | None = Field(
        description="The median distance, pixels, of matches from the epipolar lines of the cameras."
    )
    reprojection: float | None = Field(description="The median reprojection error, pixels, of points that it shares.")


class CheckedPhotographs(BaseModel):
    """The photographs that were checked.

    Small pictures of them lie in their order in the sheet previews/photographs.webp, row by row, and where there are
    masks, the masked ones in previews/masks.webp.
    """

    tile: int = Field(gt=0, description="The side, in pixels, of the square that holds one picture of a sheet.")
    columns: int = Field(gt=0, description="The squares in a row of a sheet.")
    masks: bool = Field(description="Whether there is a sheet of masked photographs.")
    middle: Place = Field(description="The middle of the reconstructed region, in the capture's frame.")
    radius: float = Field(gt=0, description="The radius of that region.")
    photographs: list[CheckedPhotograph]
