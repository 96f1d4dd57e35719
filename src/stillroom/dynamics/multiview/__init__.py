"""Multi-view geometry in the manner of DynaSLAM: what stands before a surface that keyframes saw is moving."""
