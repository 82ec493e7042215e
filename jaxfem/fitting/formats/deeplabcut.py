"""DeepLabCut's CSV (Mathis et al. 2018): rows scorer, bodyparts, coords; pixels x, y and a likelihood of each part."""

import numpy as np

from jaxfem.fitting.errors import FitError
from jaxfem.fitting.formats.base import Format, Request, check_once
from jaxfem.fitting.formats.content import Content, blank, separator_of, table
from jaxfem.fitting.recording import Recording

LIKELY = 0.6  # DeepLabCut's own threshold (pcutoff)
LABELS = ("scorer", "individuals", "bodyparts", "coords")


class DeepLabCut(Format, word="deeplabcut"):
    """Pixels of one camera: positions are (u, v, 0) and `camera` (3, 4) projects places [m] to them."""

    title = "DeepLabCut CSV"

    @classmethod
    def claims(cls, content: Content) -> bool:
        """It begins with the row scorer."""
        return not content.binary and content.first.lower().lstrip('"').startswith("scorer")

    @classmethod
    def read(cls, content: Content, asked: Request) -> Recording:
        """Samples less likely than 0.6 are missing. The rate must be given; the camera, to fit."""
        where = cls.where(content.path)
        separator = separator_of([content.first])
        rows = [(k, row) for k, row in enumerate(content.rows(separator), 1) if not blank(row)]
        heads = {row[0].lower(): row for _, row in rows[:4] if row[0].lower() in LABELS}
        if "bodyparts" not in heads or "coords" not in heads:
            raise FitError(f"{where} lacks the row bodyparts or coords: export it with DeepLabCut again")
        data = rows[len(heads) :]
        if len(data) < 2:
            raise FitError(f"{where} holds {len(data)} rows of samples; a motion needs at least two")
        found: dict[str, dict[str, int]] = {}
        owners = heads.get("individuals", [""] * len(heads["coords"]))
        several = len(set(owners[1:])) > 1
        for k, (owner, part, what) in enumerate(zip(owners, heads["bodyparts"], heads["coords"], strict=False)):
            if k:
                name = f"{owner}:{part}" if several else part
                own = found.setdefault(name, {})
                check_once(where, name, what.lower(), own)
                own[what.lower()] = k
        names = [name for name, each in found.items() if {"x", "y"} <= set(each)]
        if not names:
            raise FitError(f"{where} has no part with coords x and y")
        kinds = [what for what in ("x", "y", "likelihood") if all(what in found[name] for name in names)]
        columns = [(found[name][what], f"{name} {what}") for name in names for what in kinds]
        values = table(where, data, [(0, "frame"), *columns], separator != ",")
        cells = values[:, 1:].reshape(len(data), len(names), len(kinds))
        positions = np.concatenate([cells[..., :2], np.zeros_like(cells[..., :1])], axis=-1)
        doubtful = cells[..., 2] < LIKELY if len(kinds) == 3 else np.zeros(cells.shape[:2], bool)
        positions[doubtful] = np.nan
        notes = [f"{int(doubtful.sum())} samples less likely than {LIKELY} are missing"] if doubtful.any() else []
        times = cls.times(content, values[:, 0], None, asked, "give the camera's, rate=100 or --rate 100 say")
        return cls.made(content, times, positions, names, "px", notes, camera=asked.camera)
