"""Point clouds of people whose truth is known, and the measures that judge codecs of them (Lien and Bajcsy 2006,
section 5).
"""
