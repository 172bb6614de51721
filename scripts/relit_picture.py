"""Extract the picture of the textured model in new light, for the docs, from the report of a run.

python scripts/relit_picture.py out/teapot_hdr/report.html docs/images/relit.png
"""

from __future__ import annotations

import base64
import io
import re
import sys
from pathlib import Path

from PIL import Image


def main() -> None:
    report, target = Path(sys.argv[1]).read_text(encoding="utf-8"), Path(sys.argv[2])
    found = re.findall(r'src="data:image/webp;base64,([^"]+)"[^>]*alt="Textured model', report)
    pictures = [Image.open(io.BytesIO(base64.b64decode(each))).convert("RGBA") for each in found]
    strip = Image.new("RGBA", (sum(each.width for each in pictures), pictures[0].height), "white")
    for number, picture in enumerate(pictures):
        strip.alpha_composite(picture, (number * picture.width, 0))
    strip.convert("RGB").save(target, optimize=True)


if __name__ == "__main__":
    main()
