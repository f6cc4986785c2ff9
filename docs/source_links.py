"""A hook of MkDocs: links to the sources become text, because the site has no sources; GitHub shows the links."""

import re
from typing import Any

_LINK = re.compile(r"\[`([^`\]]+)`\]\(\.\./([\w/]+\.py)\)")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with ``name`` (``path``) in place of a link to a source; ``path`` alone if the name is its end."""

    def text(link: re.Match[str]) -> str:
        name, path = link.groups()
        return f"`{name}`" if path.endswith(name) else f"`{name}` (`{path}`)"

    return _LINK.sub(text, markdown)
