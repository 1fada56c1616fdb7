"""The validation of Jiang et al. (Strain 2019), repeated: section 2.3 and the example of figures 5 and 6."""
