"""What calls of `step`, `rollout` and their like raise."""


class StepError(ValueError):
    """A call of `step` or `rollout` that cannot be right; the message says what to change."""
