"""Selection of the channels of an image file that hold its colours and its alpha."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mgsr.errors import SceneError, in_short

# The layer names that programs give the whole picture, where a file has several colour layers.
_WHOLE = ("", "combined", "beauty", "rgba", "rgb", "color")


@dataclass(frozen=True)
class Channels:
    """The channels of an image file that hold its colours and its alpha.

    part: the file's subimage; only EXRs have several. colors: the channels that are red, green and blue, or grey alone.
    alpha: the alpha channel, or None. multiplied: whether the colours come premultiplied by alpha.
    """

    part: int
    colors: tuple[int, ...]
    alpha: int | None
    multiplied: bool

    @property
    def all(self) -> tuple[int, ...]:
        """Return the channels to read, colours first and then alpha."""
        return self.colors if self.alpha is None else (*self.colors, self.alpha)


def find_channels(handle: Any, name: str, source: str) -> Channels:
    """Find the colour and alpha channels of an opened image (OpenImageIO's ImageInput), and leave it at their part.

    name: the image file's name. source: the file that asks for it. Raises SceneError for an EXR without colours, or
    with several colour layers of which none is known to be the whole picture.
    """
    if handle.format_name() != "openexr":
        return _by_place(handle)
    known: list[str] = []
    part = 0
    while handle.seek_subimage(part, 0):
        names = handle.spec().channelnames
        layer = _layer(_layers(names))
        if layer is not None:
            return Channels(part, *layer, multiplied=layer[1] is not None)
        known += names
        part += 1
    raise SceneError(
        f"{name}: expected channels R, G, B (and A) or Y, got {in_short(', '.join(known))} (named by {source}); save "
        "only the photograph's layer"
    )


def _by_place(handle: Any) -> Channels:
    """Return the channels of any format but EXR, where the colours come first."""
    spec = handle.spec()
    colors = (0, 1, 2) if spec.nchannels >= 3 else (0,)
    alpha = spec.channelnames.index("A") if "A" in spec.channelnames else None
    straight = spec.getattribute("oiio:UnassociatedAlpha")
    # Only TIFF allows both kinds of alpha; OpenImageIO reports the wrong kind for BMP and GIF.
    return Channels(0, colors, alpha, alpha is not None and handle.format_name() == "tiff" and not straight)


def _layers(names: tuple[str, ...]) -> dict[str, dict[str, int]]:
    """Return each layer's channels: the layer is the name before the last dot, and its values map channel to index."""
    layers: dict[str, dict[str, int]] = {}
    for place, name in enumerate(names):
        layer, _, channel = name.rpartition(".")
        layers.setdefault(layer, {})[channel.upper()] = place
    return layers


def _layer(layers: dict[str, dict[str, int]]) -> tuple[tuple[int, ...], int | None] | None:
    """Return the colours and alpha of the layer that is the whole picture; None if no layer is."""
    for wanted in ("RGB", "Y"):
        # X and Y together are coordinates, not colours.
        fitting = {name: of for name, of in layers.items() if set(wanted) <= set(of) and "X" not in of}
        whole = [of for name, of in fitting.items() if name.rpartition(".")[2].lower() in _WHOLE]
        chosen = whole[:1] or list(fitting.values())
        if len(chosen) == 1:
            return tuple(chosen[0][channel] for channel in wanted), chosen[0].get("A")
    alone = [place for of in layers.values() for place in of.values()]
    return ((alone[0],), None) if len(alone) == 1 else None
