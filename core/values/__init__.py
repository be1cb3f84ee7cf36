"""The values of the monitor: levels, samples, elements, field paths, names, texts, errors. They import nothing else."""
