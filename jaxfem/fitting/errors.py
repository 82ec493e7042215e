"""The one exception of fitting."""


class FitError(ValueError):
    """A recording, marker or setting that cannot be fitted; the message names it and says what to change."""
