"""The generic model that ships: a female pelvis, of the demo's organs and the structures that support them.

Textbook anatomy, simplified: ligaments, fasciae and the pelvic floor cannot be seen in MRI, and their places follow the
three levels of support of the vagina. Level 1: uterosacral and cardinal ligaments hold its top. Level 2: pubocervical
and rectovaginal fasciae hold its walls at the side walls of the pelvis. Level 3: its lower end stands in the pelvic
floor. The pubourethral ligaments hold the neck of the bladder.

References
----------
.. [1] J. O. L. DeLancey: Anatomic aspects of vaginal eversion after hysterectomy. Am. J. Obstet. Gynecol. 166, 1992.
.. [2] K. Singh, W. M. N. Reid, L. A. Berger: Magnetic resonance imaging of normal levator ani anatomy and function.
   Obstet. Gynecol. 99, 2002.
.. [3] Gynecological influencing factors on the rectovaginal septum's morphology. Int. Urogynecol. J. 32, 1427, 2021.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..geometry.surface import BSplineSurface
from ..phantoms.organs import ORGANS, TRUE_NET, organ_surface
from .cuts import OrganCuts
from .drawing import Drawing
from .model import MultiPatchModel

# Where the column of each name begins around the tube, in sixteenths of a turn from the right (0) over the front (4):
# at knots of the net 17x13.
_AROUND = {
    "bladder": {"right anterior": 2, "anterior": 3, "left anterior": 5, "left": 6, "posterior": 10, "right": 14},
    "vagina": {"anterior": 2, "left": 6, "left posterior": 10, "posterior": 11, "right posterior": 13, "right": 14},
    "rectum": {"anterior": 2, "left": 6, "posterior": 10, "right": 14},
}
# Where the row of each name begins, in tenths of the way from the lower to the upper pole.
_UPWARD = {
    "bladder": {"outlet": 0, "neck": 1, "base": 2, "body": 4, "dome": 7},
    "vagina": {"introitus": 0, "wall": 2, "fornix": 6, "vault": 8},
    "rectum": {"anorectal": 0, "lower": 2, "middle": 4, "upper": 6, "rectosigmoid": 8},
}
# Nets of the fine version. With the cuts above, bladder and vagina have the numbers of control points of table 3 of the
# paper, 4608 and 1017; the rectum has 1094 in place of 1098. With m points around and k rows between two poles an organ
# has m k + 2 points. 1096 = 8 * 137, but 4 columns and 5 rows of cubic patches need m >= 12 and k >= 14.
FINE_NETS = {"bladder": (77, 43), "vagina": (18, 22), "rectum": (31, 16)}
# Thicknesses of sheets, mm. In MRI of women the iliococcygeal part of the levator ani is 2.9 mm thick (standard
# deviation 0.8 mm) [2]_, the rectovaginal septum 2.2 to 2.8 mm (1.2 to 1.7 mm) [3]_. Of the others no measurement was
# found: that the fascia in front is as thick as the one behind, and the cardinal ligament as the muscle, is assumed.
THICKNESS_MM = {
    "levator ani": 3.0,
    "rectovaginal fascia": 2.5,
    "pubocervical fascia": 2.5,
    "cardinal ligament": 3.0,
}
LANDMARKS = {
    "symphysis, lower margin": (0.0, 58.0, -44.0),
    "coccyx, tip": (0.0, -64.0, -46.0),
    "right ischial spine": (51.0, -30.0, -14.0),
    "left ischial spine": (-51.0, -30.0, -14.0),
    "right pubic tubercle": (24.0, 66.0, -10.0),
    "left pubic tubercle": (-24.0, 66.0, -10.0),
}
# The uterosacral ligaments run around the rectum, which lies a little to the right.
_BOWS = {"right": (14.0, 4.0, 0.0), "left": (10.0, 4.0, 0.0)}
_MIRROR = np.array([-1.0, 1.0, 1.0])


def pelvis(*, fine: bool = False) -> MultiPatchModel:
    """Draw the generic pelvis.

    Parameters
    ----------
    fine : bool
        Whether the organs have about the numbers of control points of the paper's complex model (table 3: 4608, 1017
        and 1098; here 4608, 1017 and 1094).

    Returns
    -------
    MultiPatchModel
        Bladder, vagina and rectum of the demo without its dents and folds; uterosacral, cardinal and pubourethral
        ligaments, pubocervical and rectovaginal fasciae, levator ani. RAS mm, where the demo's pelvis is.

    Examples
    --------
    >>> from VICRegistrationLib.multipatch.pelvis import pelvis
    >>> pelvis()
    MultiPatchModel(14 parts, 107 patches, 2012 points)
    """
    drawing = Drawing(_organs(fine), {organ: _cuts(organ) for organ in _AROUND})
    for side, mirror in (("right", np.ones(3)), ("left", _MIRROR)):
        _ligaments(drawing, side, mirror)
        _fasciae(drawing, side, mirror)
    _floor(drawing)
    return drawing.model(name="pelvis, fine" if fine else "pelvis", landmarks=LANDMARKS)


def _organs(fine: bool) -> dict[str, BSplineSurface]:
    return {
        organ: organ_surface(replace(ORGANS[organ], presses=()), net=FINE_NETS[organ] if fine else TRUE_NET)
        for organ in _AROUND
    }


def _cuts(organ: str) -> OrganCuts:
    around, upward = _AROUND[organ], _UPWARD[organ]
    names = [[f"{organ} {row} {column}" for row in upward] for column in around]
    u = np.array(list(around.values())) / 16.0
    v = np.array([*upward.values(), 10]) / 10.0
    return OrganCuts(u, v, names)


def _ligaments(drawing: Drawing, side: str, mirror: np.ndarray) -> None:
    """Add the uterosacral, cardinal and pubourethral ligament of a side."""
    drawing.cord(
        f"{side} uterosacral ligament",
        f"vagina fornix {side} posterior",
        mirror * (25.0, -63.0, 18.0),
        mirror * (-0.1, -1.0, 0.2),
        taper=0.6,
        bow=mirror * _BOWS[side],
        fixed="sacrum",
    )
    drawing.cord(
        f"{side} pubourethral ligament",
        f"bladder neck {side} anterior",
        mirror * (11.0, 57.0, -33.0),
        mirror * (0.0, 1.0, -0.5),
        taper=0.7,
        fixed="pubis",
    )
    drawing.sheet(
        f"{side} cardinal ligament",
        drawing.border(f"vagina fornix {side}", _front(side)),
        mirror * [(52.0, -14.0, 2.0), (50.0, -20.0, 30.0)],
        thickness=THICKNESS_MM["cardinal ligament"],
        fixed=f"{side} side wall",
    )


def _fasciae(drawing: Drawing, side: str, mirror: np.ndarray) -> None:
    """Add the pubocervical and the rectovaginal fascia of a side."""
    drawing.sheet(
        f"{side} pubocervical fascia",
        drawing.border(f"vagina wall {side}", _front(side)),
        mirror * [(22.0, 52.0, -33.0), (43.0, 26.0, -22.0), (51.0, -8.0, -10.0)],
        thickness=THICKNESS_MM["pubocervical fascia"],
        fixed=f"{side} arcus tendineus",
    )
    drawing.sheet(
        f"{side} rectovaginal fascia",
        drawing.border(f"vagina wall {side}", _back(side)),
        mirror * [(44.0, -2.0, -27.0), (49.0, -16.0, -20.0), (51.0, -30.0, -12.0)],
        thickness=THICKNESS_MM["rectovaginal fascia"],
        fixed=f"{side} arcus tendineus",
    )


def _floor(drawing: Drawing) -> None:
    """Add the levator ani: a patch behind the rectum, and three on each side of rectum and vagina."""
    part, thickness = "levator ani", THICKNESS_MM["levator ani"]
    coccyx = [(-44.0, -42.0, -28.0), (0.0, -64.0, -46.0), (44.0, -42.0, -28.0)]
    back = drawing.sheet(
        "levator ani posterior",
        drawing.border("rectum lower posterior", "v_min"),
        coccyx,
        part=part,
        thickness=thickness,
        fixed="coccyx",
    )
    for side, mirror in (("right", np.ones(3)), ("left", _MIRROR)):
        # u runs from right to left over the front.
        right = side == "right"
        order = slice(None) if right else slice(None, None, -1)
        common = {"part": part, "thickness": thickness, "fixed": f"{side} arcus tendineus"}
        rear = drawing.sheet(
            f"levator ani {side}",
            drawing.border(f"rectum lower {side}", "v_min"),
            mirror * [(44.0, -42.0, -28.0), (50.0, -12.0, -31.0)][order],
            **{("first" if right else "last"): back.indices[-1 if right else 0]},
            **common,
        )
        front = drawing.sheet(
            f"levator ani {side} anterior",
            drawing.border(f"vagina wall {side}", "v_min"),
            mirror * [(50.0, 0.0, -34.0), (40.0, 32.0, -40.0), (18.0, 57.0, -43.0)][order],
            **common,
        )
        sides = front.indices[0 if right else -1], rear.indices[-1 if right else 0]
        drawing.sheet(
            f"levator ani {side} middle",
            drawing.line(sides[0][0], sides[1][0]),
            [drawing.point(sides[0][-1]), drawing.point(sides[1][-1])],
            first=sides[0],
            last=sides[1],
            **common,
        )


def _front(side: str) -> str:
    """Front border of the column on a side."""
    return "u_max" if side == "right" else "u_min"


def _back(side: str) -> str:
    """Back border of the column on a side."""
    return "u_min" if side == "right" else "u_max"
