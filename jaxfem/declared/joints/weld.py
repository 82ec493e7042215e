"""A joint that leaves no motion."""

from collections.abc import Iterator
from dataclasses import field
from typing import Any

import numpy as np

from jaxfem.declared.errors import SceneError, checked_vector
from jaxfem.declared.joints.base import Attachments, Joint, Part
from jaxfem.inputs import Nodes, Vector, takes
from jaxfem.rows.locks import FrameLock, PointLock


class WeldJoint(Joint, kind="weld"):
    """`a` and `b` move as one.

    Between rigid bodies or the world: all of their relative motion is locked at `anchor`. With a soft `a`: each of its
    `nodes` (a group's name, a mask or indices) is tied to the material point of `b` at its place.
    """

    anchor: Any = field(default=(0.0, 0.0, 0.0), metadata=takes(Vector("m")))
    nodes: Any = field(default=None, metadata=takes(Nodes(optional=True)))

    def __post_init__(self) -> None:
        super().__post_init__()
        checked_vector(f'anchor of "{self.label}"', self.anchor)

    def unused(self) -> Iterator[str]:
        """The anchor of a soft one, which is tied node by node."""
        if self.nodes is not None and np.any(np.asarray(self.anchor, float)):
            yield "an anchor beside nodes"

    def parts(self, bodies: Attachments, where: str) -> Iterator[Part]:
        """Locks of a point and of frames, or of each node."""
        kind, number = bodies.find(self.a, where)
        if kind == "soft":
            for place in self._places(bodies.soft[number], where):
                yield self._point(bodies, place, where)
            return
        if self.nodes is not None:
            raise SceneError(f"{where} names nodes, which belong to a soft body: make that one `a`")
        yield self._point(bodies, self.anchor, where)
        frames = bodies.frame(self.a, np.eye(3), where), bodies.frame(self.b, np.eye(3), where)
        yield Part("frame", FrameLock(*frames), self.softness)

    def _point(self, bodies: Attachments, place: Any, where: str) -> Part:
        ends = bodies.point(self.a, place, where), bodies.point(self.b, place, where)
        return Part("point", PointLock(*ends), self.softness)

    def _places(self, body: Any, where: str) -> np.ndarray:
        """Where the tied nodes are, (k, 3)."""
        if self.nodes is None:
            raise SceneError(f'{where} welds a soft body: give the `nodes` that it ties, like nodes="x+"')
        chosen = body.nodes_of("nodes of a weld", self.nodes)
        if not len(chosen):
            raise SceneError(f"{where} ties no node: its selection of nodes is empty")
        places: np.ndarray = body.mesh.points[chosen]
        return places
