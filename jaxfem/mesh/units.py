"""Units of length of a file that does not say them: guessed from how long the thing is, and said, never applied."""

from .checks import Floats

LONG = 5.0  # m: what is longer and comes without a scale is asked about
SHORT = 1e-4  # m


def doubt(size: Floats, name: str) -> str | None:
    """A question where a thing of `size` (3,) [m], read without a scale, is unlikely to be in m; None otherwise."""
    longest = float(max(size))
    if longest >= LONG:
        small = longest * 1e-3
        return f'"{name}" is {longest:.4g} m long: are these mm? Then give scale = 1e-3 ({small:.4g} m); else scale = 1'
    if 0 < longest <= SHORT:
        return f'"{name}" is {longest:.2g} m long: lengths are in m. Give scale, the unit in m (1 if this is right)'
    return None
