"""What a sweep refuses."""


class SweepError(ValueError):
    """A sweep that cannot be right; the message names the variable or output and says what to change."""
