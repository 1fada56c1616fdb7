"""Sentences of the library in the language of Slicer."""

from __future__ import annotations

from slicer.i18n import getContext, translate

from .. import messages


def sentence(diagnostic):
    """Put a diagnostic into a sentence in the language of Slicer.

    Parameters
    ----------
    diagnostic : VICRegistrationLib.messages.Diagnostic

    Returns
    -------
    str
    """
    return diagnostic.sentence(lambda text: translated(text, messages))


def translated(text, module):
    """Translate a text that a module of the library marks for translation.

    Parameters
    ----------
    text : str
    module : module
        Where the text is marked: Slicer stores translations by file, and `tr` would look in those of its caller.

    Returns
    -------
    str
    """
    return translate(getContext(module.__file__), text)
