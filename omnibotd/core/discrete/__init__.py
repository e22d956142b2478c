"""Discrete navigation by four blue floor tiles to the letter (Burbridge 2010, §6.4): the thesis' first navigator.

Its SOM, colour channels, buckets and route search are those of `omnibotd.core.thesis`. What the thesis doesn't publish
is marked [assumed] beside its constant.
"""
