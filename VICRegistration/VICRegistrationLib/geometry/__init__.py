"""B-spline surfaces, generic organ models, parametrizations and validity checks; knows nothing of images."""
