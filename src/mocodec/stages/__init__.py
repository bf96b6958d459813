"""The arithmetic of coding: pairs of functions, arrays in, arrays out."""
