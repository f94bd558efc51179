"""How Sphinx builds the site, `make docs`: the pages here, and those that `generated` makes."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

from sphinx.util.inspect import TypeAliasForwardRef

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS), str(DOCS.parent)]
# For notebooks and the commands' help, which are processes of their own.
os.environ['PYTHONPATH'] = f'{DOCS.parent}:{os.environ.get("PYTHONPATH", "")}'

import generated  # noqa: E402  # Both lie where the line before says.

from uav_mission_manager import __version__  # noqa: E402
from uav_mission_manager.mdp import arrays  # noqa: E402

project = 'uav_mission_manager'
author = 'The authors of uav_mission_manager'
copyright = f'{author}; Apache-2.0'
release = __version__
extensions = ['myst_nb', 'sphinx.ext.autodoc', 'sphinx.ext.viewcode', 'numpydoc']
highlight_language = 'bash'  # Blocks without a language are commands.
default_role = 'code'

myst_heading_anchors = 4  # Links to headings, as code hosts make them.
myst_enable_extensions = ['tasklist']
nb_execution_mode = 'force'
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_execution_timeout = 120
nb_merge_streams = True

autodoc_member_order = 'bysource'
autodoc_typehints_format = 'short'
ALIASES = {'ArrayLike', 'DTypeLike', *(name for name in vars(arrays) if name.endswith('Array'))}
autodoc_type_aliases = {name: name for name in ALIASES}
TypeAliasForwardRef.__repr__ = lambda alias: alias.name  # In unions and tuples Sphinx shows this.
add_module_names = False
autodoc_preserve_defaults = True
numpydoc_show_class_members = False

html_theme = 'furo'
html_title = f'UAV mission manager {release}'  # The sidebar breaks long words.
html_copy_source = False
html_static_path = ['site.css']
html_css_files = ['site.css']


MARKUP = re.compile(r'(?<![\\*])\*(?!\*)|(?<=\w)_(?!\w)|\|')
"""Signs that reStructuredText would take for markup where they stand in a sentence."""


def as_site_links(app: Any, docname: str, source: list[str]) -> None:
    """Lead links to the repository's own pages to where the site has them."""
    names = '|'.join(generated.COPIES)
    source[0] = re.sub(rf'\]\(\.\./({names})', r'](reference/\1', source[0])


def as_plain_text(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Escape the signs of V*, *rules, names_ and |x| in the sentences of docstrings."""
    for number, line in enumerate(lines):
        parts = re.split(r'(`[^`]*`)', line)
        parts[::2] = [re.sub(MARKUP, r'\\\g<0>', part) for part in parts[::2]]
        lines[number] = ''.join(parts)


def setup(app: Any) -> None:
    """Write the generated pages, and take part in reading the others."""
    generated.write(DOCS)
    app.connect('source-read', as_site_links)
    app.connect('autodoc-process-docstring', as_plain_text, priority=100)
