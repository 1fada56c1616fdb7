"""Images in RAS millimetres: reading, labels, regions, sampling, morphology, moments."""
