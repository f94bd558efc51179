"""The frame of what commands write for a browser: it loads nothing and runs no script."""

from __future__ import annotations

from html import escape
from string import Template

DOCUMENT = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<title>$title</title>
<style>$style</style>
</head>
<body>
<h1>$title</h1>
$body
</body>
</html>
""")


def html_document(title: str, style: str, body: str) -> str:
    """Return a document; its body is HTML already."""
    return DOCUMENT.substitute(title=escape(title), style=style, body=body)
