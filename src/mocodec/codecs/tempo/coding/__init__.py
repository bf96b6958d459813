"""Coefficients as bytes.

rows            what the rows of a chunk's coefficients are, and their quantisation steps
contexts        the table that codes each coefficient, from expected magnitudes and decoded neighbours
plan            what encoder and decoder know of a chunk before its first symbol
quantise        integers for coefficients, by rate and distortion
coefficients    integers as bytes, and back
corrections     what moves samples that are too far off back within the bound
direct          samples on a grid, for what no transform suits
"""
