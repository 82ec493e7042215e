"""A sweep over several devices is that over one, variant by variant."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

SCRIPT = """
import json
import jax
import numpy as np
import jaxfem as jf

jax.config.update("jax_enable_x64", True)
body = jf.SoftBody(jf.mesh.box((0.1, 0.03, 0.03), (2, 1, 1)), 2e5, 0.3, 1e3, fixed="x-")
scene = jf.build(jf.Scene([body], gravity=(0, 0, -9.81)))
variants = {"young": np.append(np.geomspace(1e5, 1e6, 6), -1.0)}
told = {}
for engine in ("lanes", "loop"):
    for count in (1, 2):
        options = {"dt": 5e-3, "steps": 4, "every": 4, "engine": engine, "width": 2, "derivatives": ["young"]}
        outputs = {"tip": lambda run: run.last.positions[-1, 2]}
        made = jf.sweep(*scene, variants, outputs=outputs, devices=jax.local_devices()[:count], **options)
        found = made["tip"], made.derivative("tip", "young"), made.status
        told[engine + str(count)] = [each.tolist() for each in found]
print(json.dumps({"devices": jax.local_device_count(), "told": told}))
"""


@pytest.mark.slow
def test_two_devices_give_what_one_gives():
    """Seven variants, two a device and chunk, so that the last chunk is not full; the last variant is a bad one."""
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_force_host_platform_device_count=2"
    environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
    run = subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout.splitlines()[-1])
    told = found["told"]
    assert found["devices"] == 2
    for engine in ("lanes", "loop"):
        (tip, slope, status), (alone, its, also) = told[f"{engine}2"], told[f"{engine}1"]
        assert status == also and [code == 0 for code in status] == [True] * 6 + [False]
        # Two programs, whose sums may be in another order.
        np.testing.assert_allclose(tip[:6], alone[:6], rtol=1e-9)
        np.testing.assert_allclose(slope[:6], its[:6], rtol=1e-7)
