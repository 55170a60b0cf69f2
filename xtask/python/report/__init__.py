"""The accuracy report: reads tables of measurements, writes one page with pictures and the table of docs/accuracy.md."""
