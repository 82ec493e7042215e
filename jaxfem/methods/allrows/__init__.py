"""Methods that solve for the impulses of all rows."""
