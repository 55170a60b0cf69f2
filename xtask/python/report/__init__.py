"""The accuracy report: tables of measurements in, one page with pictures and the table of docs/accuracy.md out."""
