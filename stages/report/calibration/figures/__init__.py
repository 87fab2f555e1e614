"""Figures of a calibration's page: each file draws one."""
