"""The stages of coding: pairs of functions, forward and inverse, arrays in, arrays out."""
