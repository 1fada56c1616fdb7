"""Other programs read STEP files too: gmsh as many solids as there are organs, with their names; Netgen meshes one.

Each runs in a process of its own: both bring an Open CASCADE of their own along.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys

import pytest
from step_organs import organ

from VICRegistrationLib.export.step import Solid, write_step
from VICRegistrationLib.phantoms.organs import pelvic_organs

GMSH = """
import json, sys
import gmsh
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
solids = gmsh.model.occ.importShapes(sys.argv[1])
gmsh.model.occ.synchronize()
found = {gmsh.model.getEntityName(*solid).split("/")[-1]: gmsh.model.occ.getMass(*solid) for solid in solids}
print("RESULT" + json.dumps({"solids": found, "faces": len(gmsh.model.getEntities(2))}))
gmsh.finalize()
"""

# As the paper meshes organs (its figure 17).
NETGEN = """
import json, sys
import numpy as np
from netgen.occ import OCCGeometry
geometry = OCCGeometry(sys.argv[1])
mesh = geometry.GenerateMesh(maxh=6.0)
points = np.array([list(point.p) for point in mesh.Points()])
corners = points[np.array([[vertex.nr - 1 for vertex in element.vertices] for element in mesh.Elements3D()])]
volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
result = {"solids": [solid.mass for solid in geometry.shape.solids], "meshed": volumes.sum(), "least": volumes.min()}
print("RESULT" + json.dumps(result))
"""


def reading(script, package, path):
    """What a program found in a file; skips where it is not installed."""
    if importlib.util.find_spec(package) is None:
        pytest.skip(f"{package} is not installed")
    done = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.split("RESULT")[1])


@pytest.mark.parametrize("faces", [1, 4])
def test_gmsh_reads_an_assembly_with_its_names(tmp_path, faces):
    organs = pelvic_organs()
    write_step([Solid(name, surface) for name, surface in organs.items()], tmp_path / "a.step", faces=faces)
    found = reading(GMSH, "gmsh", tmp_path / "a.step")
    # Its quadrature is coarser than the geometry it holds.
    assert found["solids"] == {name: pytest.approx(surface.volume(), rel=1e-5) for name, surface in organs.items()}
    assert found["faces"] == 3 * faces


def test_netgen_reads_and_meshes_a_solid(tmp_path):
    surface = organ((17, 13))
    write_step([Solid("bladder", surface)], tmp_path / "a.step")
    found = reading(NETGEN, "netgen", tmp_path / "a.step")
    assert found["solids"] == [pytest.approx(surface.volume(), rel=1e-5)]
    assert found["least"] > 0.0
    # Straight edges of 6 mm cut corners off.
    assert found["meshed"] == pytest.approx(surface.volume(), rel=0.03)
