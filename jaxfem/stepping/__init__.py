"""Steps and rollouts: what is called in a loop."""

from jaxfem.stepping.checks import StepError, check_call
from jaxfem.stepping.entering import typed
from jaxfem.stepping.impulses import impulses
from jaxfem.stepping.remembering import with_memory
from jaxfem.stepping.step import prepare, rollout, step

__all__ = ["StepError", "check_call", "impulses", "prepare", "rollout", "step", "typed", "with_memory"]
