"""Control nets of different sizes: cost, distance from truth and experts, time."""

from __future__ import annotations

import time

from accuracy import demo_cases, of_surface, real_case
from bladders import bladders
from measuring import table

from VICRegistrationLib.messages import sentences
from VICRegistrationLib.registration.options import FitOptions
from VICRegistrationLib.registration.organ import fit_region
from VICRegistrationLib.registration.steps import finish
from VICRegistrationLib.segmentation.separation import separate

NETS = ((9, 7), (17, 11), (33, 19))


def report(*, quick: bool) -> str:
    """Fit every organ with each net, whatever the criterion would choose; and print what it chooses, and why."""
    found = bladders()
    cases = [*demo_cases(), *(real_case(bladder) for bladder in found[: 0 if quick else None])]
    reasons = []
    rows = [["organ", "net", "cost", "both mm", "both 95 %", "normals deg", "time / 9x7"]]
    for case in cases[: 1 if quick else None]:
        region, first = separate(case.image, case.seeds), 0.0
        for net in NETS[: 2 if quick else None]:
            start = time.perf_counter()
            fit = finish(fit_region(case.image, region, FitOptions(net=net)))
            seconds = time.perf_counter() - start
            first = first or seconds
            off = of_surface(fit.surface, case)
            sizes = (f"{fit.cost_final:.4f}", f"{off.both.mean:.3f}", f"{off.both.p95:.2f}", f"{off.angle:.1f}")
            rows.append([case.name, "{}x{}".format(*net), *sizes, f"{seconds / first:.1f}"])
        chosen = next(c for c in finish(fit_region(case.image, region)).choices if c.option == "net")
        reasons.append(f"  - {case.name}: {chosen.value}. {sentences(chosen.reasons)}")
    return (
        "  Nets given; the rest is chosen. Measures as in accuracy, whose nets are chosen.\n\n"
        f"{table(rows)}\n\n  Chosen where none is given:\n" + "\n".join(reasons)
    )
