"""jaxfem: a differentiable solver for soft bodies, in pure JAX."""
