"""The page report.html: a self-contained file for a browser without network."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path

import numpy as np

from mgsr.report.charts import Axes, Boundary, Series, line_chart, short_number
from mgsr.report.data import ReportData, finite
from mgsr.report.decisions import stage_name, with_decisions
from mgsr.report.encode import data_address
from mgsr.report.inspection import camera_map, finding_rows
from mgsr.report.pictures import RAMP, Picture, ReportPictures, SurfacePictures, TestViewPictures
from mgsr.report.scores import scores_told
from mgsr.report.style import CSS, SCRIPT

HERO_SIDE, TILE_SIDE = 512, 320  # longest sides in pixels, so that a report stays small enough to send
MOST_VIEWS = 8
COLUMNS = {1: "two", 2: "two", 3: "three", 4: "four", 5: "five", 6: "six", 7: "four", 8: "four", 9: "five"}
STEPS = (
    "total",
    "load",
    "check",
    "learned_masks",
    "start",
    "exposures",
    "object",
    "background",
    "plan",
    "train",
    "export",
    "mesh",
    "evaluate",
    "model",
    "render",
    "report",
)


def write_report_html(path: Path, data: ReportData, pictures: ReportPictures) -> None:
    """Write the page to `path`.

    The page is self-contained; all text from the run is escaped.
    """
    path.write_text(report_page(data, pictures), encoding="utf-8")


def report_page(data: ReportData, pictures: ReportPictures) -> str:
    """Return the page as text."""
    title = escape(data.scene)
    sections = (
        _object_masks(pictures.masks),
        _light_split(pictures.views),
        _environment_map(pictures.environment_maps),
        _surface(data, pictures.surface),
        _relit(pictures.relit),
        _more_views(pictures.views),
        _curves(data),
        _scores(data),
        _inspection(data),
        _decisions(data),
        _settings(data),
    )
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{title} · MGSR</title><style>{CSS}</style></head>\n<body>'
        f"<header><h1>{title}</h1>{_lead(data)}</header>\n<main>{_hero(pictures.views)}{_key_figures(data)}"
        + "\n".join(section for section in sections if section)
        + f"</main>\n<footer>Made by MGSR {escape(str(data.versions.get('mgsr', '')))}.</footer>"
        f"<script>{SCRIPT}</script></body></html>\n"
    )


def _lead(data: ReportData) -> str:
    words = []
    if data.input is not None:
        words = [f"{len(data.input.train_views)} photographs", "{} × {} pixels".format(*data.input.image_size)]
    words += [f"{data.method} {data.preset}", f"on {data.device}"]
    return f'<p class="lead">{escape(", ".join(words))}</p>'


def _hero(views: Sequence[TestViewPictures]) -> str:
    if not views:
        return ""
    return (
        f'<section aria-label="One test view">{_view_row(views[0], HERO_SIDE, "hero")}'
        f'<p class="note" style="margin-top:10px">View {escape(views[0].name)}, which training never saw.</p></section>'
    )


def _view_row(view: TestViewPictures, side: int, extra: str = "") -> str:
    named = (
        ("photograph", view.photo),
        ("render", view.render),
        ("render with its background", view.whole),
        ("transmitted light", view.transmitted),
        ("weight × reflected light", view.reflected),
        ("even light, no flash", view.unlit),
        ("normals", view.normal),
        ("depth", view.depth if view.mesh is None or view.unlit is not None else None),
        ("mesh", view.mesh),
    )
    tiles = [_tile(f"{view.name}: {name}", name, pixels, side) for name, pixels in named if pixels is not None]
    return f'<div class="row {COLUMNS[len(tiles)]} {extra}">{"".join(tiles)}</div>'


def _tile(alt: str, caption: str, pixels: np.ndarray, side: int) -> str:
    return (
        f'<figure><div class="tile">{_image(alt, pixels, side)}</div>'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _row(what: str, pictures: Sequence[Picture], side: int, columns: str) -> str:
    """Return pictures side by side. A picture's alternative text is `what` followed by its caption."""
    tiles = (_tile(f"{what} {each.caption}", each.caption, each.pixels, side) for each in pictures)
    return f'<div class="row {columns}">{"".join(tiles)}</div>'


def _image(alt: str, pixels: np.ndarray, side: int, attributes: str = "") -> str:
    height, width = pixels.shape[:2]
    return (
        f'<img src="{data_address(pixels, side)}" width="{width}" height="{height}" '
        f'alt="{escape(alt, quote=True)}"{attributes}>'
    )


def _key_figures(data: ReportData) -> str:
    values = {score.label: value for score, value in scores_told(data)}
    figures = [("Time", *_duration(data.seconds.get("total", 0.0)))]
    for label in ("PSNR", "Chamfer distance", "Normal error"):
        if label in values:
            value, _, unit = values[label].partition(" ")
            figures.append((label, value, unit))
    figures.append(("Gaussians", short_number(sum(data.gaussians.values())), ""))
    if data.mesh is not None:
        figures.append(("Faces", short_number(data.mesh.faces), ""))
    cells = (
        f"<div><dt>{escape(label)}</dt><dd>{escape(value)}<small>{escape(unit)}</small></dd></div>"
        for label, value, unit in figures
    )
    return f'<dl class="key">{"".join(cells)}</dl>'


def _duration(seconds: float) -> tuple[str, str]:
    if seconds < 120:
        return f"{seconds:.0f}" if seconds >= 10 else f"{seconds:.1f}", "s"
    if seconds < 7200:
        return f"{seconds // 60:.0f}:{seconds % 60:02.0f}", "min"
    return f"{seconds // 3600:.0f}:{seconds % 3600 // 60:02.0f}", "h"


def _light_split(views: Sequence[TestViewPictures]) -> str:
    if not views or views[0].transmitted is None or views[0].reflected is None:
        return ""
    view = views[0]
    pair = _image(f"{view.name}: transmitted light", view.transmitted, HERO_SIDE)  # type: ignore[arg-type]
    pair += _image("reflected light, added", _light_alone(view.reflected), HERO_SIDE, ' id="reflected"')  # type: ignore[arg-type]
    return (
        f'<section><h2>The light split</h2><div class="split"><div class="tile stack">{pair}</div><div><p>A render is '
        "the sum of two lights. Transmitted light is the object’s own colour. Reflected light comes from gloss and "
        "lamps, times a learned weight. The mesh takes its colours from transmitted light, so they contain no "
        'highlights.</p><label for="fade">Reflected light</label><input id="fade" data-fade="reflected" type="range" '
        'min="0" max="100" value="100"><p class="note">Left: the object’s own colour alone. Right: the full '
        "render.</p></div></div></section>"
    )


def _object_masks(pictures: Sequence[Picture]) -> str:
    if not pictures:
        return ""
    return (
        "<section><h2>The found object</h2><p>The capture has no masks, so MGSR found the object itself. Everything "
        "else is grey. The figure under a photograph tells how well its mask agrees with the masks of the other "
        "photographs. The photographs range from the worst to the best. To correct a mask, edit its file in "
        "<code>masks/</code>, put the folder beside the photographs, and run again.</p>"
        f"{_row('Mask of', pictures, TILE_SIDE, 'three')}</section>"
    )


def _environment_map(pictures: Sequence[Picture]) -> str:
    if not pictures:
        return ""
    return (
        "<section><h2>The environment map</h2><p>This is the light that the surface reflects. MGSR learned it from "
        "the highlights, which move over the surface between photographs. All splats share it, so highlights are "
        "right from new viewpoints as well. The picture is brightened until its brightest pixel is white.</p>"
        f"{_row('Environment map,', pictures, HERO_SIDE, 'environment')}</section>"
    )


def _light_alone(pixels: np.ndarray) -> np.ndarray:
    """Convert a picture of light over black [H,W,3] to uint8 [H,W,4] that is transparent where there is no light.

    Added to another picture, it gives the same light. Opaque black would be visible at the rounded corners.
    """
    brightest = pixels[..., :3].max(axis=2, keepdims=True)
    straight = pixels[..., :3] / np.maximum(brightest / 255, 1 / 255)
    return np.concatenate([np.rint(straight).clip(0, 255).astype(np.uint8), brightest], axis=2)


def _more_views(views: Sequence[TestViewPictures]) -> str:
    rest = views[1:MOST_VIEWS]
    if not rest:
        return ""
    rows = "".join(f"<h3>{_view_title(view)}</h3>{_view_row(view, TILE_SIDE)}" for view in rest)
    left = len(views) - 1 - len(rest)
    note = f'<p class="note">The folder renders/test has {left} more.</p>' if left else ""
    return f"<section><h2>More test views</h2><p>Training saw none of these photographs.</p>{rows}{note}</section>"


def _view_title(view: TestViewPictures) -> str:
    return escape(view.name) + ("" if view.psnr is None else f' <span class="note">{view.psnr:.1f} dB</span>')


def _surface(data: ReportData, surface: SurfacePictures) -> str:
    if not surface.shaded:
        return ""
    parts = [f"<p>{_mesh_words(data)}</p>", _sides("shaded", surface.shaded)]
    if surface.colored:
        parts += ["<h3>With vertex colours</h3>", _sides("coloured", surface.colored)]
    if surface.distance:
        parts += ["<h3>Distance to the true surface</h3>", _sides("distance to the truth", surface.distance)]
        parts.append(_distance_legend(surface.limit))
    return f"<section><h2>The surface</h2>{''.join(parts)}</section>"


def _relit(pictures: Sequence[Picture]) -> str:
    if not pictures:
        return ""
    return (
        "<section><h2>In new light</h2><p>The textured model, <code>model.glb</code>, in a studio that turns around "
        "it. The photographs&rsquo; light is divided out of its colours as far as it is known. The remaining light "
        "does not turn with the studio.</p>"
        f"{_row('Textured model,', pictures, TILE_SIDE, COLUMNS[len(pictures)])}</section>"
    )


def _mesh_words(data: ReportData) -> str:
    if data.mesh is None:
        return "The mesh is shaded from four sides."
    mesh = data.mesh
    pieces = "one piece" if mesh.components == 1 else _counted(mesh.components, "piece")
    rim = _counted(mesh.boundary_edges, "boundary edge") if mesh.boundary_edges else "closed"
    holes = f" around {_counted(mesh.holes, 'hole')}" if mesh.holes and mesh.boundary_edges else ""
    return f"{mesh.vertices:,} vertices and {mesh.faces:,} faces in {pieces}, {rim}{holes}."


def _counted(count: int, thing: str) -> str:
    return f"{count:,} {thing}" + ("" if count == 1 else "s")


def _sides(kind: str, pictures: Sequence[Picture]) -> str:
    return _row(f"Mesh, {kind},", pictures, TILE_SIDE, COLUMNS[min(len(pictures), 6)])


def _distance_legend(limit: float) -> str:
    stops = "".join(
        f'<stop offset="{index / (len(RAMP) - 1):.3f}" stop-color="rgb({r:.0f} {g:.0f} {b:.0f})"/>'
        for index, (r, g, b) in enumerate(RAMP)
    )
    return (
        '<div class="legend"><span>0</span><svg viewBox="0 0 100 5" preserveAspectRatio="none" '
        f'aria-hidden="true"><defs><linearGradient id="ramp">{stops}</linearGradient></defs><rect width="100" '
        f'height="5" fill="url(#ramp)"/></svg><span>{limit:.1%} of the object’s radius or more</span></div>'
    )


def _curves(data: ReportData) -> str:
    if len(data.curve) < 2:
        return ""
    boundaries = _boundaries(data)
    lines = [
        Series("2D", "a", [(row.seconds, row.psnr_surfels) for row in data.curve if row.psnr_surfels is not None]),
        Series("3D", "b", [(row.seconds, row.psnr_gaussians) for row in data.curve if row.psnr_gaussians is not None]),
    ]
    if not any(line.points for line in lines):
        lines = [Series("PSNR", "a", [(row.seconds, row.psnr) for row in data.curve if row.psnr is not None])]
    error = line_chart(lines, Axes("PSNR on test views, dB", "seconds of training", "dB"), boundaries)
    counts = [
        Series("2D", "a", [(row.seconds, row.surfels) for row in data.curve if row.surfels]),
        Series("3D", "b", [(row.seconds, row.gaussians) for row in data.curve if row.gaussians]),
    ]
    number = line_chart(counts, Axes("Gaussians", "seconds of training", "count", True), boundaries)
    charts = "".join(
        f"<div><h3>{title}</h3>{chart}</div>"
        for title, chart in (("PSNR on test views", error), ("Number of Gaussians", number))
        if chart
    )
    if not charts:
        return ""
    return f'<section><h2>Training</h2><div class="charts">{charts}</div>{_curve_table(data)}</section>'


def _boundaries(data: ReportData) -> list[Boundary]:
    """Return the beginnings of the stages. In the curve, each is the last row of the stage before."""
    found = [Boundary(0.0, stage_name(data.curve[0].stage))]
    for before, row in zip(data.curve, data.curve[1:], strict=False):
        if row.stage != before.stage:
            found.append(Boundary(before.seconds, stage_name(row.stage)))
    return found


def _curve_table(data: ReportData) -> str:
    head = ("Seconds", "Stage", "Iteration", "2D, dB", "3D, dB", "2D Gaussians", "3D Gaussians")
    rows = [
        (
            f"{row.seconds:.1f}",
            stage_name(row.stage),
            f"{row.iteration:,}",
            _decibels(row.psnr_surfels),
            _decibels(row.psnr_gaussians),
            f"{row.surfels:,}",
            f"{row.gaussians:,}",
        )
        for row in data.curve
    ]
    return f"<details><summary>Show as a table</summary>{_table(head, rows)}</details>"


def _decibels(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    top = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _worded_table(head: Sequence[str], rows: Sequence[tuple[str, str, str]]) -> str:
    """Return a table of name, value and a sentence. On a narrow screen, the sentence is below the other two."""
    top = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in head)
    body = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td class="n">{escape(value)}</td>'
        f'<td class="w">{escape(words)}</td></tr>'
        for name, value, words in rows
    )
    return f'<div class="wide words"><table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _scores(data: ReportData) -> str:
    rows = [(score.label, value, score.meaning) for score, value in scores_told(data)]
    if not rows:
        return ""
    note = "" if data.gt else '<p class="note">The capture has no true surface, so the shape is not scored.</p>'
    return f"<section><h2>Scores</h2>{note}{_worded_table(('Score', 'Value', 'What it means'), rows)}</section>"


def _decisions(data: ReportData) -> str:
    rows = [(each.what, each.choice, each.why) for each in with_decisions(data).decisions]
    table = _worded_table(("What", "Choice", "Why"), rows)
    return f"<section><h2>Decisions</h2>{table}</section>" if rows else ""


def _inspection(data: ReportData) -> str:
    inspection = data.inspection
    if not inspection:
        return ""
    rows = finding_rows(inspection)
    table = _worded_table(("Severity", "How bad", "What"), rows) if rows else "<p>Nothing was found.</p>"
    drawn = camera_map(inspection)
    note = '<p class="note">The cameras; those of errors and warnings are filled, crosses mark missing photographs.</p>'
    return f"<section><h2>The photographs, checked</h2>{table}{drawn}{note if drawn else ''}</section>"


def _settings(data: ReportData) -> str:
    facts = [("Preset", data.preset), ("Method", data.method), ("Device", data.device), ("Seed", str(data.seed))]
    facts += [(f"Gaussians, {name}", f"{count:,}") for name, count in data.gaussians.items()]
    facts += [("Peak memory", f"{data.peak_memory_mib:,.0f} MiB")]
    facts += [(_seconds_name(name), f"{value:.1f}") for name, value in data.seconds.items()]
    facts += [(f"Version of {name}", str(value)) for name, value in data.versions.items()]
    machine = {} if data.machine is None else asdict(data.machine)
    facts += [(f"Machine, {name}", str(value)) for name, value in machine.items()]
    rows = "".join(f'<tr><th scope="row">{escape(name)}</th><td>{escape(value)}</td></tr>' for name, value in facts)
    command = f"<h3>Command</h3><pre>{escape(data.command)}</pre>" if data.command else ""
    return (
        f"<section><h2>How to repeat this run</h2>{command}<div "
        f'class="wide"><table><tbody>{rows}</tbody></table></div>{_all_settings(data)}</section>'
    )


def _seconds_name(name: str) -> str:
    return f"Seconds, {name}" if name in STEPS else f"Seconds, stage “{stage_name(name)}”"


def _all_settings(data: ReportData) -> str:
    if data.settings is None:
        return ""
    text = json.dumps(finite(data.settings), indent=2, ensure_ascii=False, default=str)
    return f"<details><summary>All settings</summary><pre>{escape(text)}</pre></details>"
