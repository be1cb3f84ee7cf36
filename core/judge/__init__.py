"""The judge: samples and time in, transitions and reports out, as docs/rules.md defines them."""
