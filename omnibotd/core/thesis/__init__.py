"""The method of the thesis to the letter (Burbridge 2010, §6.3 and §6.5): the baseline that all else is measured by.

What the thesis doesn't publish is marked [assumed] beside its constant.
"""
