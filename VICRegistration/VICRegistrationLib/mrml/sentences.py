"""Sentences of the library in the language of Slicer."""

from __future__ import annotations

from slicer.i18n import getContext, translate

from .. import messages


def sentence(diagnostic):
    """Put a diagnostic of the library into a sentence.

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
        Slicer collects the texts of a file under its name: `tr` would look among those of the file that calls it.

    Returns
    -------
    str
    """
    return translate(getContext(module.__file__), text)
