"""Multi-view geometry as in DynaSLAM: what occludes a surface that keyframes saw is dynamic."""
