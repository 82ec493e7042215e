"""`jaxfem view`: the results of a run as one page that plays them in any browser."""

import argparse
import threading
import webbrowser
from pathlib import Path
from typing import Any

from jaxfem.io.live import show
from jaxfem.io.pages import graphs_of, write_page
from jaxfem.io.reading import Frame, read_frames
from jaxfem.io.scene_files import SceneFileError


def add(subparsers: Any) -> None:
    """Add the command to the parser."""
    parser = subparsers.add_parser(
        "view",
        help="look at results in a browser",
        description="Write one HTML page that plays the results of a run: turn, move and zoom, colour by displacement, "
        "stress or speed, graphs in step. It needs no server and no network, and can be sent as it is.",
    )
    parser.add_argument("results", metavar="RESULTS", help="a folder that a run wrote, or its .pvd index")
    parser.add_argument("--out", metavar="PAGE.html", help="the page, instead of NAME.html beside the index")
    parser.add_argument("--most", type=float, default=10.0, metavar="MB", help="frames are left out beyond (10)")
    parser.add_argument("--open", action="store_true", help="open it in the browser")
    parser.add_argument("--live", action="store_true", help="serve a live viewer in place of the page (viser)")
    parser.add_argument("--port", type=int, default=8080, metavar="N", help="of the live viewer (8080)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the page, or serve a viewer until it is interrupted; 0."""
    if not args.most > 0 or not 0 <= args.port <= 65535:
        raise SceneFileError("--most is a positive number of MB, --port a number from 0 to 65535")
    index = _index(Path(args.results))
    frames = read_frames(index)
    target = Path(args.out) if args.out else index.with_suffix(".html")
    if not frames:
        raise SceneFileError(f"{index} lists no frame: the run ended before its first one")
    if args.live:
        return _served(frames, args)
    path, held = write_page(target, frames, index.stem, graphs_of(index.parent), args.most * 1e6)
    left = f", {held} of {len(frames)} frames, to stay below {args.most:g} MB (--most)" if held < len(frames) else ""
    print(f"wrote {path} ({path.stat().st_size / 1e6:.2g} MB{left}): open it in a browser")
    if args.open:
        webbrowser.open(path.resolve().as_uri())
    return 0


def _served(frames: list[Frame], args: argparse.Namespace) -> int:
    """A live viewer, until Ctrl-C."""
    viewer = show(frames, port=args.port)
    print(f"{viewer.address} plays {len(frames)} frames; Ctrl-C ends it", flush=True)
    if args.open:
        webbrowser.open(viewer.address)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.stop()
    return 0


def _index(given: Path) -> Path:
    """The index of a folder, or the file itself."""
    if not given.is_dir():
        return given
    found = sorted(given.glob("*.pvd"))
    if len(found) != 1:
        names = ", ".join(path.name for path in found) or "none"
        raise SceneFileError(f"{given} must hold one .pvd index, to be shown; it holds {names}: name one of them")
    return found[0]
