"""The text of a commented scene file: a small beam clamped at one end, under its own weight."""

from collections.abc import Sequence

_BEAM = """\
# A soft beam, clamped at x = 0, that sags under gravity and comes to rest.
# Run it with: jaxfem simulate FILE.toml          Units are SI: m, s, kg, N, Pa.

gravity = [0.0, 0.0, -9.81]     # m/s^2

[time]
step = {step:<25.10g}# s
duration = {duration:<21.10g}# s; or: steps = {steps}
save_every = {every:<19}# steps per written frame
# halvings = 3                  # a step that fails is taken again in 2, 4 and 8 parts before the run ends
# scheme = "generalized_alpha"  # second order: adds next to no damping; rho_inf = 0.8, mass = "averaged"
# rotation_update = "implicit"    # of the elements, iterated to the end of the step: for steps that turn far

[solver]                        # all of it optional
method = "auto"                 # or "condensed", "mprgp"
tolerance = 1e-8                # relative residual of each step's solve
precision = "float64"           # or "float32": faster on graphics cards; take tolerance 1e-5 then

[[body]]
name = "beam"
mesh = {{ box = [{size}], cells = [{cells}], tets_per_cell = {tets_per_cell} }}
# other meshes: {{ file = "part.msh", scale = 1e-3 }}    lengths in the file are mm
#               {{ beam = [0.10, 0.03, 0.03], cells_along = 20 }}    {{ ball = 0.05, cells = 4 }}
# moved:        position = [0.0, 0.0, 0.1]    rotate = {{ axis = [0, 0, 1], degrees = 90 }}
young = {young:<24.10g}# Pa
poisson = {poisson:<22.10g}# below 0.5; plain tetrahedra are too stiff above 0.45
density = {density:<22.10g}# kg/m^3
damping = {damping:<22.10g}# s: the damping matrix is this times the stiffness matrix
fixed = "x-"                    # a group of the mesh, {{ below = {{ x = 0.001 }} }}; or a list of these
# velocity = [0.0, 0.0, 0.0]    # m/s, at the start

# Loads, as many as needed. Kinds: traction (faces, value in Pa), pressure (faces, value in Pa: a number),
# nodal_force (nodes, value in N on each of them), point_force (point in m, value in N)
# [[body.load]]
# kind = "traction"
# faces = "x+"
# value = [0.0, 0.0, -50.0]     # Pa

# Nodes that follow a prescribed motion: velocity t + amplitude sin(2 pi frequency t), and a turn about a center
# [[body.driven]]
# nodes = "x-"
# amplitude = [0.0, 0.0, 0.005] # m
# frequency = 5.0               # Hz

[output]
folder = "results"              # beside this file
# material points whose path goes to a table: where they are in the undeformed body, m
points = {{ tip = [{tip}] }}
"""


def beam_scene(
    young: float = 2.6e5,
    poisson: float = 0.45,
    damping: float = 2e-3,
    cells: Sequence[int] = (10, 3, 3),
    *,
    size: Sequence[float] = (0.10, 0.03, 0.03),
    tets_per_cell: int = 12,
    density: float = 1070.0,
    step: float = 0.01,
    steps: int = 100,
    every: int = 1,
) -> str:
    """Commented TOML text of a beam scene, a box of `size` (3,) [m] cut into `cells`, clamped at x = 0.

    Twelve tetrahedra a cell: their mesh is symmetric, and the beam does not drift sideways as it does with six.
    `young` [Pa], `damping` [s], `density` [kg/m^3], `step` [s]; a tracked point "tip" in the middle of the free end.
    """
    length, width, height = size
    return _BEAM.format(
        young=young,
        poisson=poisson,
        damping=damping,
        density=density,
        tets_per_cell=tets_per_cell,
        size=", ".join(f"{each:g}" for each in size),
        cells=", ".join(str(each) for each in cells),
        tip=", ".join(f"{each:g}" for each in (length, width / 2, height / 2)),
        step=step,
        steps=steps,
        duration=step * steps,
        every=every,
    )
