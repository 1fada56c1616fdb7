"""gmsh and Netgen read STEP files too: as many solids, in mm, with their names, and they can mesh them.

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
found = [(gmsh.model.getEntityName(*solid).split("/")[-1], gmsh.model.occ.getMass(*solid)) for solid in solids]
gmsh.option.setNumber("Mesh.MeshSizeMin", 6)
gmsh.option.setNumber("Mesh.MeshSizeMax", 6)
gmsh.model.mesh.generate(3)
_, tetrahedra, _ = gmsh.model.mesh.getElements(3)
volumes = gmsh.model.mesh.getElementQualities(tetrahedra[0], "volume")
result = {
    "solids": found, "faces": len(gmsh.model.getEntities(2)), "meshed": sum(volumes), "smallest": min(volumes),
}
print("RESULT" + json.dumps(result))
gmsh.finalize()
"""

NETGEN = """
import json, sys
import numpy as np
from netgen.occ import OCCGeometry
geometry = OCCGeometry(sys.argv[1])
mesh = geometry.GenerateMesh(maxh=6.0)
points = np.array([list(point.p) for point in mesh.Points()])
corners = points[np.array([[vertex.nr - 1 for vertex in element.vertices] for element in mesh.Elements3D()])]
volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
result = {
    "solids": [("", solid.mass) for solid in geometry.shape.solids], "faces": len(geometry.shape.faces),
    "meshed": volumes.sum(), "smallest": volumes.min(),
}
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
@pytest.mark.parametrize(
    ("package", "script"), [("gmsh", GMSH), pytest.param("netgen", NETGEN, marks=pytest.mark.long)]
)
def test_an_assembly_is_read_and_meshed(tmp_path, package, script, faces):
    organs = pelvic_organs()
    write_step([Solid(name, surface) for name, surface in organs.items()], tmp_path / "a.step", faces=faces)
    found = reading(script, package, tmp_path / "a.step")
    # Their quadrature is coarser than the geometry they hold.
    expected = [pytest.approx(surface.volume(), rel=1e-5) for surface in organs.values()]
    assert [volume for _, volume in found["solids"]] == expected
    if package == "gmsh":
        assert [name for name, _ in found["solids"]] == list(organs)
    assert found["faces"] == 3 * faces
    assert found["smallest"] > 0.0
    # Straight edges of 6 mm cut corners off organs of a radius from 7 mm.
    assert found["meshed"] == pytest.approx(sum(surface.volume() for surface in organs.values()), rel=0.03)


@pytest.mark.parametrize("closure", ["smooth", "paper"])
@pytest.mark.parametrize("faces", [1, 3])
@pytest.mark.parametrize(("package", "script"), [("gmsh", GMSH), ("netgen", NETGEN)])
def test_either_closure_is_read_and_meshed(tmp_path, package, script, faces, closure):
    surface = organ((17, 13), closure=closure)
    write_step([Solid("bladder", surface)], tmp_path / "a.step", faces=faces)
    found = reading(script, package, tmp_path / "a.step")
    assert [volume for _, volume in found["solids"]] == [pytest.approx(surface.volume(), rel=1e-5)]
    assert found["faces"] == faces
    assert found["smallest"] > 0.0
    assert found["meshed"] == pytest.approx(surface.volume(), rel=0.03)
