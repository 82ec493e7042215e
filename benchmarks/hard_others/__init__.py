"""Hard cases by other engines; none of these files imports jaxfem."""
