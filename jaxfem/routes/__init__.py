"""Routes to the solution of one step: the same condition, solved on all rows (dual) or on the nodes (condensed)."""
