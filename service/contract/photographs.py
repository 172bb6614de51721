"""The photographs of a job and their cameras, as the check before training found them."""

from __future__ import annotations

from pydantic import BaseModel, Field

Place = tuple[float, float, float]


class CheckedPhotograph(BaseModel):
    """A photograph and its camera, in the capture's frame."""

    name: str
    center: Place = Field(description="The camera's position.")
    direction: Place = Field(description="The unit direction in which the camera looks.")
    up: Place = Field(description="The unit direction of the image's upper side.")
    angles: tuple[float, float] = Field(description="The horizontal and the vertical field of view, in degrees.")
    residual: float | None = Field(
        description="The median distance, in pixels, of matches from the cameras' epipolar lines."
    )
    reprojection: float | None = Field(description="The median reprojection error of its shared points, in pixels.")


class CheckedPhotographs(BaseModel):
    """The photographs of a check.

    The sheet previews/photographs.webp holds small pictures of them, in order and row by row. If there are masks,
    previews/masks.webp holds the masked photographs.
    """

    tile: int = Field(gt=0, description="The side, in pixels, of the square for one picture of a sheet.")
    columns: int = Field(gt=0, description="The number of squares in a row of a sheet.")
    masks: bool = Field(description="Whether there is a sheet of masked photographs.")
    middle: Place = Field(description="The centre of the reconstructed region, in the capture's frame.")
    radius: float = Field(gt=0, description="The radius of the reconstructed region, in the capture's unit.")
    photographs: list[CheckedPhotograph]
