"""hmdjit: how much does the picture flicker when a head tries to hold still?"""

__version__ = "0.1.0"
