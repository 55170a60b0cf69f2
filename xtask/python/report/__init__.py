"""The accuracy report: tables of measurements in, one page with pictures and the README's table out."""
