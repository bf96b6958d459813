"""The page as one file: the built viewer with a session inside."""

from __future__ import annotations

import base64
import gzip
import hashlib
import html
import json
from functools import cache
from importlib import resources
from typing import Any

from ..codecs.tempo.models import prior as priors

PLACE = '<script type="application/json" id="session">null</script>'


@cache
def viewer() -> str:
    """The built page without data: index.html of web/viewer with its style and script inside."""
    return resources.files("mocodec.viewer").joinpath("static/viewer.html").read_text("utf-8")


def prior(identifier: str) -> bytes:
    """The file of a prior of tempo in the package, by its identifier. Raises KeyError if there is none."""
    for file in (priors.POINTS_FILE, priors.DIRECTIONS_FILE):
        data = priors.packaged_bytes(file)
        if hashlib.blake2b(data, digest_size=priors.ID_BYTES).hexdigest() == identifier:
            return data
    raise KeyError(identifier)


def with_session(session: dict[str, Any]) -> str:
    """The page with a session inside, as HTML. Names in it cannot end the element that they stand in."""
    text = json.dumps(session, ensure_ascii=True, separators=(",", ":"), allow_nan=False)
    inside = PLACE.replace("null", escaped(text))
    page = viewer()
    if page.count(PLACE) != 1:
        raise RuntimeError("the built page has no place for a session: build it again with scripts/web")
    return page.replace(PLACE, inside)


def escaped(text: str) -> str:
    """JSON that may stand in a script element: "<", ">" and "&" only occur in strings, where escapes stand for them."""
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


FRAME = """<iframe title="{title}" style="width:100%;height:{height}px;border:1px solid #8884;border-radius:8px" \
sandbox="allow-scripts" srcdoc="{document}"></iframe>"""

UNPACKING = """<!doctype html><meta charset="utf-8"><script>(async()=>{{const t=atob("{data}"),\
b=new Uint8Array(t.length);for(let i=0;i<t.length;i++)b[i]=t.charCodeAt(i);\
const s=await new Response(new Blob([b]).stream().pipeThrough(new DecompressionStream("gzip"))).text();\
document.open();document.write(s);document.close()}})()</script>"""


def in_frame(session: dict[str, Any], height: int = 520) -> str:
    """The page within a frame, compressed, for a notebook: it has no access to the notebook around it."""
    data = base64.b64encode(gzip.compress(with_session(session).encode(), 9, mtime=0)).decode("ascii")
    return FRAME.format(
        title=html.escape(session["title"], quote=True),
        height=height,
        document=html.escape(UNPACKING.format(data=data), quote=True),
    )
