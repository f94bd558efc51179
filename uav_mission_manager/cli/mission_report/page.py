"""The frame of a report: one HTML page that loads nothing, runs no script, and prints on A4."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from uav_mission_manager.arguments import version_line
from uav_mission_manager.cli.html_document import html_document
from uav_mission_manager.console.map_overlay import OVERLAY_STYLE
from uav_mission_manager.console.style import COLOURS
from uav_mission_manager.console.timeline import TIMELINE_STYLE
from uav_mission_manager.drawing.base_map import MAP_STYLE

REPORT_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;color:var(--ink);background:#fff;margin:1.5rem auto;
max-width:62rem;padding:0 1rem}
h1{font-size:1.6rem;margin:0 0 .3rem;overflow-wrap:anywhere}
h2{font-size:1.2rem;margin:1.8rem 0 .3rem;padding-top:.3rem;border-top:2px solid var(--ink)}
h3{font-size:1rem;margin:1rem 0 .2rem}p{margin:.3rem 0 .6rem}ul{margin:.3rem 0 .6rem;
padding-left:1.3rem}.note,.foot{color:var(--dim);font-size:.85rem}
table{border-collapse:collapse;width:100%;margin:.5rem 0 1rem;font-size:.92rem}
th,td{padding:.2rem .5rem;border-bottom:1px solid var(--line);text-align:left;
vertical-align:top;overflow-wrap:break-word}
th{font-weight:600;color:var(--dim);font-size:.82rem}
.n{text-align:right;font-variant-numeric:tabular-nums}td.n{white-space:nowrap}
.story th:nth-child(1){width:3rem}.story th:nth-child(2){width:1.6rem}
.story th:nth-child(3){width:21%}.story th:nth-child(5){width:25%}
.story th:nth-child(6){width:3rem}
tr.command td{background:#eef4fa}tr.command .what{font-weight:700;color:var(--craft)}
tr.warning .what{font-weight:600;color:#8a5a00}tr.danger .what{font-weight:700;
color:var(--danger)}.no{display:inline-block;min-width:1.3em;padding:0 .2em;border-radius:.7em;
background:var(--craft);color:#fff;text-align:center;font-size:.85em;font-weight:700;
white-space:nowrap}
dl.facts{display:grid;grid-template-columns:max-content 1fr;gap:.1rem 1rem;margin:.3rem 0}
dl.facts dt{color:var(--dim)}dl.facts dd{margin:0;overflow-wrap:anywhere}
svg{width:100%;height:auto}svg.map{max-height:70vh}
.strip{display:grid;grid-template-columns:max-content 1fr;margin:.2rem 0 .6rem}
.strip .timeline-names{padding:19px 8px 0 0;white-space:pre}
.strip svg{width:auto;max-width:100%}
.legend{display:flex;flex-wrap:wrap;gap:.3rem 1.2rem;list-style:none;padding:0;font-size:.88rem}
.legend svg{width:1.6rem;height:1.1rem;vertical-align:-.2rem;margin-right:.4rem;font-size:8px}
.bar{display:grid;grid-template-columns:minmax(0,14rem) minmax(3rem,1fr) 5rem;gap:.5rem;
align-items:center}.bar .track{height:.8rem;background:#eceae4}.bar .fill{display:block;
height:100%;background:var(--craft)}.bar .amount{text-align:right}.bar.choice{font-weight:700}
.bars h2{font-size:.9rem;border:0;margin:.6rem 0 .1rem;padding:0}
*{-webkit-print-color-adjust:exact;print-color-adjust:exact}
@page{size:A4;margin:14mm 12mm}
@media print{body{font-size:9.5pt;margin:0;max-width:none;padding:0}
h2,h3,h2+.note{break-after:avoid}tr,svg,.strip,table:not(.story,.maps){break-inside:avoid}
thead{display:table-header-group}
svg.map{max-height:120mm}}
"""
"""Style of reports, beside that of maps and timelines."""


def page(title: str, body: Iterable[str]) -> str:
    """Return a report; the parts of its body are HTML already."""
    style = '\n'.join((MAP_STYLE, COLOURS, OVERLAY_STYLE, TIMELINE_STYLE, REPORT_STYLE))
    foot = f'<p class="foot">{escape(version_line())}</p>'
    return html_document(title, style, '\n'.join((*body, foot)))


def facts(entries: Iterable[tuple[str, str]]) -> str:
    """Names and values below each other."""
    rows = (f'<dt>{escape(name)}</dt><dd>{escape(value)}</dd>' for name, value in entries)
    return f'<dl class="facts">{"".join(rows)}</dl>'


def table(heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """A table of texts; columns of numbers stand to the right."""

    def line(cells: Sequence[str], tag: str) -> str:
        parts = (
            f'<{tag}{" class=n" if place in numbers else ""}>{escape(cell)}</{tag}>'
            for place, cell in enumerate(cells)
        )
        return f'<tr>{"".join(parts)}</tr>'

    body = '\n'.join(line(row, 'td') for row in rows)
    return f'<table><thead>{line(heads, "th")}</thead><tbody>\n{body}\n</tbody></table>'


def note(text: str) -> str:
    """A small remark."""
    return f'<p class="note">{escape(text)}</p>'


def clock(seconds: float) -> str:
    """A time of a flight: minutes and seconds, with hours where there are any."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f'{hours}:{minutes:02}:{rest:02}' if hours else f'{minutes}:{rest:02}'
