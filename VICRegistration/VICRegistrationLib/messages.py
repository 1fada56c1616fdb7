"""What the library says about a result: a code with its values, and one table of their English sentences.

The command line shows the sentences as they are, and the Slicer module translates the same table: each sentence is
written once. Knows nothing of the rest of the library.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field


def marked(text: str) -> str:
    """Mark a text for Slicer's translators, who look for `_("...")`; it is translated where it is shown."""
    return text


_ = marked

# A new diagnostic is a new line here. Its values are in braces, as str.format takes them.
SENTENCES = {
    # The separated region.
    "region_at_border": _(
        "The organ reaches the border of the image ({sides}) and may go on outside of it; there the surface is not "
        "that of the organ."
    ),
    "reaches_border": _(
        "The organ reaches the border of the image ({sides}) with {share:.1%} of its area, and may go on outside of "
        "it; there the surface is not that of the organ."
    ),
    "region_larger_than_seen": _(
        "The separated region has {region_ml:.1f} ml, but the wall that is seen from the seeds encloses {seen_ml:.1f} "
        "ml: the region may have leaked into other tissue (threshold {low:.5g} to {high:.5g}, erosion {erosion_mm:g} "
        "mm). Look at the contour; if it has leaked, narrow the threshold or increase the erosion."
    ),
    "start_contradicted": _(
        "Boundary points were up to {away_mm:.0f} mm from the surface that was fitted first, so the organ was "
        "separated again, without a threshold, with the help of a surface through the points."
    ),
    "starts_differ": _(
        "Growing by grey levels finds {grown_ml:.1f} ml, the search for a closed surface {shaped_ml:.1f} ml. "
        "The one of {taken_ml:.1f} ml was taken, because it agrees better with the image. Look at the contour; if a "
        "part is missing, add a seed there, and if it goes too far, place points on the wall."
    ),
    "surfaces_differ": _(
        "The search for a closed surface finds {star_ml:.1f} ml from one centre, and {along_ml:.1f} ml along the "
        "organ's axis. The one of {taken_ml:.1f} ml was taken, because its edges are clearer where they differ. Look "
        "at both ends of the organ; if one is wrong, place points on the wall."
    ),
    "segmentation_in_pieces": _(
        "The segmentation has {count} pieces. The largest was taken; the others, {left_out:.0%} of the voxels, were "
        "left out. If they belong to the organ, fill the slices between the pieces."
    ),
    "layer_included": _(
        "The image shows a flat, horizontal edge of {area_cm2:.0f} cm2 in the organ, with even grey levels on both "
        "sides: probably the level of a layer, such as sediment, blood or contrast agent. The {layer_ml:.1f} ml "
        "behind it, at the {side} side, were taken as part of the organ. Look at the contour there."
    ),
    "ends_at_level": _(
        "The boundary is flat and horizontal over {area_cm2:.0f} cm2 at the {side} side: this may be the level of a "
        "layer in the organ and not its wall. Look at the contour there, and place points on the wall behind it."
    ),
    # Why a surface is no valid solid.
    "open_along": _("The surface is open along R {r:.1f}, A {a:.1f}, S {s:.1f} mm (u {u:.3g}, v {v:.3g})."),
    "rim": _("The surface has a rim at R {r:.1f}, A {a:.1f}, S {s:.1f} mm (u {u:.3g}, v {v:.3g})."),
    "folded_pole": _(
        "The pole at R {r:.1f}, A {a:.1f}, S {s:.1f} mm (u {u:.3g}, v {v:.3g}) is folded: the surface does not wind "
        "around it exactly once."
    ),
    "no_normal": _(
        "The surface has no normal at R {r:.1f}, A {a:.1f}, S {s:.1f} mm (u {u:.3g}, v {v:.3g}): it is pinched into a "
        "line or a point there."
    ),
    "folded_over": _("The surface is folded over at R {r:.1f}, A {a:.1f}, S {s:.1f} mm (u {u:.3g}, v {v:.3g})."),
    "inside_out": _(
        "The surface is inside out: its normal at R {r:.1f}, A {a:.1f}, S {s:.1f} mm (u {u:.3g}, v {v:.3g}) points "
        "inward."
    ),
    "passes_through_itself": _(
        "The surface passes through itself at R {r:.1f}, A {a:.1f}, S {s:.1f} mm (u {u:.3g}, v {v:.3g}), where it "
        "meets the part about u {other_u:.3g}, v {other_v:.3g}."
    ),
    # Why a surface was not taken as it was fitted first.
    "no_valid_solid": _("The surface was no valid solid ({kind})."),
    "left_surroundings": _("The surface left the surroundings of the region."),
    "far_from_region": _("The surface moved {away_mm:.1f} mm away from the region, more than half the organ's radius."),
    "held_closer": _("It was fitted again with the net {net}, and held {factor:g} times closer to the region."),
    "surface_kept": _(
        "This happened however closely it was held to the region, so the {kept} was kept, with the net {net}."
    ),
    # Why an option is what it is.
    "option_given": _("It was given."),
    "edge_width": _("The edge in the image is {width_mm:.2f} mm wide, {pixels:.1f} pixels."),
    "edge_width_limited": _(
        "The edge in the image is {width_mm:.2f} mm wide, {pixels:.1f} pixels; the value is kept between {least:g} "
        "and {most:g} pixels."
    ),
    "no_edge_width": _("The image shows no clear edge, so {pixels:g} pixels are taken."),
    "smoothness_to_start": _("It is the small value that every fit starts with."),
    "noise_along_edge": _(
        "Because of noise and uneven tissue, the image differs from an ideal edge by {share:.0%} of the contrast, in "
        "{voxels:,} voxels along it."
    ),
    "finer_net_lowered_cost": _(
        "With the net {net} the cost fell by {change:.1%}, of which noise explains {explained:.1%}."
    ),
    "finer_net_raised_cost": _("With the net {net} the cost rose by {change:.1%}; noise explains {explained:.1%}."),
    "finer_net_not_tried": _(
        "The net {net} was expected to lower the cost by {expected:.1%}, of which noise explains {explained:.1%}; it "
        "was not tried."
    ),
    "net_of_model": _("It is the net of the generic model."),
    "made_finer": _("It was refined from {net} for the boundary points."),
    # A fit.
    "invalid_surface": _("{problem} Look at the contour, and try a smaller net or another seed, threshold or erosion."),
    "no_further_step": _(
        "The fit stopped after {iterations} iterations of its stage {stage}, because no further step lowered the cost; "
        "look at the contour."
    ),
    "still_moving": _(
        "The fit stopped after {iterations} iterations of its stage {stage}, while the surface still moved by "
        "{displacement_mm:.2g} mm; look at the contour."
    ),
    "no_clear_edge": _(
        "The surface follows no clear edge: the grey levels beside it differ from those of an edge by more than half "
        "of the contrast (cost {cost:.2g}). Look at the contour, and give another seed or threshold."
    ),
    "no_edge_in_places": _(
        "The surface follows no edge on {share:.0%} of its area, and keeps there the shape that the fit began with. "
        "Look at the contour there, and place points on the wall where you know it."
    ),
    "no_edge_at_side": _(
        "The surface follows no edge on {share:.0%} of its area, mostly at its {side} side, and keeps there the shape "
        "that the fit began with. Look at the contour there, and place points on the wall where you know it."
    ),
    "points_without_edge": _(
        "The image shows no edge at {count} of {points} boundary points: only the points hold the surface there. Look "
        "at the contour there, and remove points that are not on the wall of this organ."
    ),
    "points_left": _(
        "The surface stays up to {left_mm:.1f} mm from {count} of {points} boundary points: no smooth surface passes "
        "through all of them. Look at the contour there, and remove points that contradict each other."
    ),
    "volume_differs": _(
        "The surface encloses {surface_ml:.1f} ml, but the separated region has {region_ml:.1f} ml. Look at the "
        "contour. If the region is wrong, give another threshold or erosion; if the surface is wrong, place points on "
        "the wall."
    ),
    "part_left_out": _(
        "The separated region reaches {reach_mm:.0f} mm beyond the surface at its {side} side: this is a thin part of "
        "the organ that the surface does not follow, or a leak. Look at the contour there. If the region is right, "
        "place points on the wall; if not, give another threshold or erosion."
    ),
    # A generic model of several organs.
    "organ_predicted": _(
        "The organ {organ} was not given. The generic model predicts it from the others; it was not seen in the image."
    ),
    "parts_estimated": _("Estimated by the generic model, not seen in the image: {parts}."),
    "header_trusted": _(
        "The organs do not show which side is left; the orientation in the header of the image is trusted."
    ),
    "map_compresses": _(
        "Near the {part}, the map that carries the model changes volumes by the factor {determinant:.2f}; what it "
        "carries there is hardly like the model any more. Check the regions of the organs."
    ),
    # Why a further stack was not used.
    "stack_shows_little": _(
        "The stack shows {share:.0%} of the organ's surface, too little to find the organ's place in it."
    ),
    "stack_shows_no_edge": _(
        "Wherever the stack is moved, it shows no edge along the surface (cost {cost:.2g}): the organ is filled "
        "differently, it is another organ, or there is no contrast."
    ),
    "stack_shows_another_shape": _(
        "Wherever the stack is moved, its edges are {apart_mm:.1f} mm from those of the first stack: the organ is "
        "filled differently, which no motion explains."
    ),
    "stack_moved_far": _(
        "The organ was found {shift_mm:.0f} mm and {turn_degrees:.0f} degrees away in this stack, farther than a "
        "patient moves between two stacks (15 mm, 15 degrees). Check that both stacks are of one examination."
    ),
    # A further stack that was not used.
    "stack_left_out": _("The stack {stack} was left out. {reason}"),
    # A comparison with a reference.
    "reference_in_pieces": _(
        "The reference {reference} has {count} pieces, and all of them count. --largest keeps only the largest one."
    ),
    "reference_hollow": _(
        "The reference {reference} has cavities inside ({count}), and their surfaces count as well. --largest fills "
        "them."
    ),
    "reference_open_wall": _(
        "The reference {reference} is a wall without its lumen: {share:.0%} of what it encloses in its slices is not "
        "in it, and its inner surface counts as well. Give a label that holds the lumen too, or fill it."
    ),
    "reference_mirrored": _(
        "The surface fits {reference} better with {sides} exchanged (volume Dice {mirrored_dice:.2f} instead of "
        "{dice:.2f}); one of the two is probably mirrored, or in another frame (LPS or RAS)."
    ),
    "little_in_common": _(
        "The surface has little or no volume in common with {reference} (volume Dice {dice:.2f}). Check that both are "
        "of one organ in one image; for a mesh, check its frame (LPS or RAS) and its unit (mm)."
    ),
    # A mesh of tetrahedra.
    "overlap_resolved": _("{first} and {second} overlap by {volume_mm3:.1f} mm³; the overlap was given to {second}."),
    "edges_straightened": _(
        "{count} edges of second order are straighter than the surface, so that their elements keep a good shape."
    ),
    "poor_element": _(
        "The worst element, at R {r:.1f}, A {a:.1f}, S {s:.1f} mm, has a scaled Jacobian of {jacobian:.3f}; {good:g} "
        "or more is good. Look for a crease of the surface there, or choose another element size."
    ),
    "poor_element_of_part": _(
        "The worst element of {part}, at R {r:.1f}, A {a:.1f}, S {s:.1f} mm, has a scaled Jacobian of {jacobian:.3f}; "
        "{good:g} or more is good. Choose another element size, or draw the part without what is sharp or thin there."
    ),
    # A model of several organs.
    "part_detached": _(
        "{part} shares no points with any other part, so it would not move with them. Let a border of one of its "
        "patches have the points of a border of an organ's patch."
    ),
    "foot_detached": _(
        "{part} shares {found} of the {needed} points around its foot, the patch {foot}. Let its sides begin with the "
        "points of that patch's borders."
    ),
    "part_not_closed": _(
        "{part} does not bound a solid: its patches do not meet, or are turned to different sides, at the border "
        "{side} of {patch}. Let both have the points of that border, and normals outward."
    ),
    "patch_folded": _("The patch {patch} is folded at R {r:.1f}, A {a:.1f}, S {s:.1f} mm; draw it without the fold."),
    "organ_invalid": _("{part}: {problem}"),
    "passes_through_organ": _(
        "{part} passes through {organ}, {depth_mm:.1f} mm deep at R {r:.1f}, A {a:.1f}, S {s:.1f} mm. Lead it around "
        "the organ."
    ),
    "organs_overlap": _(
        "{part} and {organ} overlap, {depth_mm:.1f} mm deep at R {r:.1f}, A {a:.1f}, S {s:.1f} mm. Look at the "
        "contours of both."
    ),
    "passes_through_cord": _(
        "{part} passes through {cord} at R {r:.1f}, A {a:.1f}, S {s:.1f} mm. Lead one of them around the other."
    ),
    "passes_through_sheet": _(
        "{part} passes through {sheet} at R {r:.1f}, A {a:.1f}, S {s:.1f} mm. Lead one of them around the other."
    ),
    "another_unit": _(
        "{part} is {size_mm:.3g} mm large; an organ has {least_mm:g} to {most_mm:g} mm. The model may be in another "
        "unit: write it again in mm."
    ),
    "model_landmark_far": _(
        "The landmark {landmark} at R {r:.0f}, A {a:.0f}, S {s:.0f} mm is {away_mm:.0f} mm from everything else in the "
        "model. Correct its place, in RAS mm."
    ),
    "another_frame": _(
        "{first} lies {direction} {second}. The model may be in another frame (LPS): write it again in RAS, x to the "
        "right, y to the front, z to the head."
    ),
}
# Words that values may be.
WORDS = (
    *(_("left"), _("right"), _("posterior"), _("anterior"), _("inferior"), _("superior")),
    *(_("left and right"), _("front and back"), _("top and bottom"), _("left and right, and front and back")),
    *(_("open"), _("folded pole"), _("flipped normal"), _("self-intersection")),
    *(
        _("surface of the region"),
        _("surface of the coarser net"),
        _("scaled model"),
        _("surface of the generic model"),
        _("closed surface of the region"),
    ),
    *(_("to the left of"), _("in front of")),
)


@dataclass(frozen=True)
class Diagnostic:
    """One thing to know about a result.

    Parameters
    ----------
    code : str
        Out of `SENTENCES`.
    values : mapping of str to object
        What the sentence says in numbers (units are in their names), words, lists of words, or other diagnostics.
    """

    code: str
    values: Mapping[str, object] = field(default_factory=dict)

    def sentence(self, translate: Callable[[str], str] = _) -> str:
        """Put it into a sentence.

        Parameters
        ----------
        translate : callable
            Takes an English text of this file; English is kept without it, and where a translation has lost a value.

        Returns
        -------
        str
        """
        english = SENTENCES[self.code]
        values = {name: _shown(value, translate) for name, value in self.values.items()}
        try:
            return translate(english).format(**values)
        except (IndexError, KeyError, ValueError):
            return english.format(**values)

    def record(self) -> dict[str, object]:
        """Code, values and English sentence, as JSON keeps them."""
        values = {
            name: value.record() if isinstance(value, Diagnostic) else value for name, value in self.values.items()
        }
        return {"code": self.code, "values": values, "sentence": self.sentence()}

    @classmethod
    def restored(cls, record: Mapping[str, object]) -> Diagnostic:
        """Read what `record` has written."""
        values = {
            name: cls.restored(value) if isinstance(value, dict) else value for name, value in record["values"].items()
        }
        return cls(record["code"], values)


def sentences(diagnostics: Iterable[Diagnostic]) -> str:
    """Put diagnostics into English sentences, one after the other.

    Parameters
    ----------
    diagnostics : iterable of Diagnostic

    Returns
    -------
    str
    """
    return " ".join(diagnostic.sentence() for diagnostic in diagnostics)


def _shown(value: object, translate: Callable[[str], str]) -> object:
    """Value as a sentence shows it."""
    if isinstance(value, Diagnostic):
        return value.sentence(translate)
    if isinstance(value, (list, tuple)):
        return ", ".join(str(_shown(part, translate)) for part in value)
    return translate(value) if isinstance(value, str) else value
