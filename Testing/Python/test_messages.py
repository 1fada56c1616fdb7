"""The table of sentences: every code has its values, and each sentence can be translated."""

from __future__ import annotations

import ast
import json
import re
import string
from pathlib import Path

import numpy as np
import pytest

from VICRegistrationLib import messages
from VICRegistrationLib.analysis import mirrored
from VICRegistrationLib.imaging.image import patient_side
from VICRegistrationLib.messages import SENTENCES, WORDS, Diagnostic

LIBRARY = Path(messages.__file__).parent


def names_of(template):
    return {name for _, name, _, _ in string.Formatter().parse(template) if name}


def codes_in_the_library():
    """Texts in the library that stand where a code may stand: all string constants but for those of the table."""
    for path in LIBRARY.rglob("*.py"):
        if path.name != "messages.py":
            tree = ast.parse(path.read_text(encoding="utf-8"))
            yield from (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))


def test_every_sentence_is_used():
    assert set(SENTENCES) <= set(codes_in_the_library())


def test_every_code_that_is_written_down_has_a_sentence_with_its_values():
    for path in LIBRARY.rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "Diagnostic":
                code, *values = call.args
                if isinstance(code, ast.Constant):
                    wanted = names_of(SENTENCES[code.value])
                    keys = [key for each in values if isinstance(each, ast.Dict) for key in each.keys]
                    given = {key.value for key in keys if key}
                    # What comes from another mapping is not seen here.
                    is_whole = all(keys) and not any(isinstance(each, ast.Name) for each in values)
                    assert given == wanted if is_whole else given <= wanted, code.value


def test_every_sentence_is_marked_for_translation():
    tree = ast.parse((LIBRARY / "messages.py").read_text(encoding="utf-8"))
    marked = {
        call.args[0].value
        for call in ast.walk(tree)
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "_" and isinstance(call.args[0], ast.Constant)
    }
    assert {*SENTENCES.values(), *WORDS} <= marked


def test_words_in_sentences_can_be_translated():
    assert {patient_side(sign * axis) for axis in np.eye(3) for sign in (-1.0, 1.0)} <= set(WORDS)
    assert set(mirrored._MIRRORS) <= set(WORDS)


def test_no_sentence_is_cut_up_again():
    cuts = re.compile(r"""partition\(["'](; |error)|split\(["'](; |error)""")
    assert [path.name for path in LIBRARY.rglob("*.py") if cuts.search(path.read_text(encoding="utf-8"))] == []


def test_a_sentence_is_translated_with_its_words_and_what_it_holds():
    german = {
        "{problem} Look at the contour, and try a smaller net or another seed, threshold or erosion.": "{problem} Hm.",
        SENTENCES["folded_over"]: "Gefaltet bei {r:.1f}.",
        SENTENCES["reaches_border"]: "Am Rand: {sides}, {share:.1%}.",
        "left": "links",
        "right": "rechts",
    }
    place = {"r": 1.26, "a": 0.0, "s": 0.0, "u": 0.0, "v": 0.0}
    found = Diagnostic("invalid_surface", {"problem": Diagnostic("folded_over", place)})
    assert found.sentence(lambda text: german.get(text, text)) == "Gefaltet bei 1.3. Hm."
    border = Diagnostic("reaches_border", {"sides": ["left", "right"], "share": 0.125})
    assert border.sentence(lambda text: german.get(text, text)) == "Am Rand: links, rechts, 12.5%."
    assert "(left, right)" in border.sentence()


@pytest.mark.parametrize("spoilt", ["Kosten {kosten}", "Kosten {", "Kosten {}", "Kosten {cost:d}"])
def test_a_translation_that_has_lost_a_value_is_not_used(spoilt):
    found = Diagnostic("no_clear_edge", {"cost": 0.5})
    assert found.sentence(lambda text: spoilt) == found.sentence()


def test_a_record_is_what_json_keeps():
    place = {"r": 1.0, "a": 2.0, "s": 3.0, "u": 0.25, "v": 0.5}
    found = Diagnostic("invalid_surface", {"problem": Diagnostic("folded_over", place)})
    record = json.loads(json.dumps(found.record()))
    assert record["code"] == "invalid_surface"
    assert record["sentence"] == found.sentence()
    assert record["values"]["problem"]["values"] == place


def test_grey_levels_and_volumes_are_told_without_exponents():
    values = {"region_ml": 30.0, "seen_ml": 20.0, "low": 12345.6, "high": 65535.0, "erosion_mm": 0.0}
    assert "(threshold 12346 to 65535," in Diagnostic("region_larger_than_seen", values).sentence()
    overlap = {"first": "bladder", "second": "vagina", "volume_mm3": 1234.5}
    assert "overlap by 1234.5 mm³;" in Diagnostic("overlap_resolved", overlap).sentence()
