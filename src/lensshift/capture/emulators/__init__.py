"""Devices that are not there: they speak the real protocols, one file each."""
