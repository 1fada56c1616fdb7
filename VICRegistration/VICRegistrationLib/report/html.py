"""Small parts of HTML: everything that is not marked as HTML is escaped."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Sequence

# Letters of a cell that is not broken into lines.
_ONE_LINE = 24
_VOID = ("img", "meta")
# Letters that HTML does not allow, and halves of letters, which file names may hold and UTF-8 may not.
_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")


class Html(str):
    """Text that is HTML already, and not escaped again."""

    __slots__ = ()


def text(content: object) -> Html:
    """Escape plain text; HTML is left as it is.

    Parameters
    ----------
    content : object
        HTML, or anything with a ``str``.

    Returns
    -------
    Html
    """
    if isinstance(content, Html):
        return content
    return Html(html.escape(_UNPRINTABLE.sub("\ufffd", str(content)), quote=True))


def element(name: str, /, *content: object, **attributes: object) -> Html:
    """Write an element.

    Parameters
    ----------
    name : str
    *content : object
        HTML or plain text, one after the other.
    **attributes : object
        Plain text. An underscore at the end of a name is left out (``class_``), one within is a hyphen
        (``http_equiv``).

    Returns
    -------
    Html
    """
    words = "".join(f' {key.rstrip("_").replace("_", "-")}="{text(value)}"' for key, value in attributes.items())
    if name in _VOID:
        return Html(f"<{name}{words}>")
    return Html(f"<{name}{words}>{joined(*content)}</{name}>")


def joined(*content: object) -> Html:
    """Write HTML or plain text one after the other.

    Parameters
    ----------
    *content : object

    Returns
    -------
    Html
    """
    return Html("".join(text(part) for part in content))


def table(titles: Sequence[object], rows: Sequence[Sequence[object]], *, caption: str = "") -> Html:
    """Write a table whose rows begin with what they are about.

    Parameters
    ----------
    titles : sequence of object
        Of the columns; none for a table of names and values.
    rows : sequence of sequence of object
        HTML or plain text.
    caption : str

    Returns
    -------
    Html
    """
    head = element("thead", element("tr", *(element("th", title, scope="col") for title in titles)))
    body = (
        element("tr", element("th", first, scope="row"), *(_cell(cell) for cell in cells)) for first, *cells in rows
    )
    content = [element("caption", caption)] if caption else []
    content += [head] if titles else []
    # Wide tables scroll by themselves on a narrow screen.
    return element("div", element("table", *content, element("tbody", *body)), class_="table")


def _cell(content: object) -> Html:
    """Cell of a table; what is no sentence stays on one line."""
    short = not isinstance(content, Html) and len(str(content)) <= _ONE_LINE
    return element("td", content, class_="number") if short else element("td", content)


def items(sentences: Sequence[object]) -> Html:
    """Write a list.

    Parameters
    ----------
    sentences : sequence of object

    Returns
    -------
    Html
    """
    return element("ul", *(element("li", sentence) for sentence in sentences))


def png_picture(content: bytes, *, alt: str, caption: object) -> Html:
    """Write a picture that is part of the page.

    Parameters
    ----------
    content : bytes
        PNG file.
    alt : str
        What it shows, for those who do not see it.
    caption : object
        HTML or plain text below it.

    Returns
    -------
    Html
    """
    width, height = (int.from_bytes(content[start : start + 4], "big") for start in (16, 20))
    source = "data:image/png;base64," + base64.b64encode(content).decode("ascii")
    image = element("img", src=source, alt=alt, width=width, height=height)
    return element("figure", image, element("figcaption", caption))
