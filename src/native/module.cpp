// mocodec._native: loops that NumPy cannot vectorise. One file for each user in the package:
//
//   entropy.cpp     packed bits and the coder with one state, for entropy/
//   state_stream.cpp      short arrays of integers in one call, for entropy/coder.py; state_streams.h decodes them
//   bulk.cpp        long arrays of integers, for entropy/bulk.py; bulk_layout.h has contexts and places
//   coefficients.cpp      contexts, quantisation and rANS lanes, for codecs/tempo/coding
//   bone_directions.cpp   directions of bones, for codecs/tempo/pose/bone_directions.py
//   bone_coordinates.cpp  inverse of bone_directions.cpp, for the same module; rotations4.h serves both
//   bit_arrays.cpp  arrays of bits with the adaptive coder of adaptive_bits.h, for entropy/bit_arrays.py
//   point_octree.cpp      octree of lattice points, for codecs/bodycast/point_octree.py; octree_surface.h has the surface
//   cube_octree.cpp       octree cube by cube, for codecs/bodycast/cube_octree.py; octree_coding.h serves both octrees,
//                   near_cubes.h compares cubes
//   point_smoothing.cpp   moves lattice points to the surface, for codecs/bodycast/point_smoothing.py; point_moves.h finds the moves
//   lattice_frames.cpp    points on a lattice, for codecs/bodycast/lattice_frames.py, lattice.py and octree.py
//   point_choice.cpp      choice of lattice points, for codecs/bodycast/point_choice.py; key_order.h sorts codes
//   point_colours.cpp     colours of lattice points, for codecs/bodycast/colour_lifting.py; colour_neighbourhood.h has the points
//                   around a point
//   colour_memory.cpp     expected colours, for codecs/bodycast/surface_memory.py
//   surface_memory.cpp    the bodies' surface over frames, for codecs/bodycast/integer_surface.py and surface_memory.py
//   reference_surface.cpp surface of points, for codecs/bodycast/reference_surface.py; nearest_others.h finds neighbours
//   clustered_icp.cpp     iterative closest points, for geometry/icp.py and articulated_icp.py (clustered_points.h is the tree), and normals,
//                   for geometry/normals.py (neighbour_cells.h)
//   link_surfaces.cpp     points around the cylinders of links, for geometry/articulated_icp.py; capsules.h: distances from
//                   capsules, for geometry/capsules.py
//   neighbours.cpp  neighbours of points and cells, for geometry/neighbours.py
//   first_pose.cpp  costs of poses, for geometry/pose_search.py (pose_scorer.h), and fits of pose and proportions, for
//                   geometry/body_fit.py (capsule_fitter.h)
//   lattice.cpp     the lattice engine, for stages/lattice.py; its parts are lattice.h, lattice_points.h and adaptive_bits.h
//   lattice_neighbours.cpp  choice of neighbours, for stages/lattice.py
//   joint_rotations.cpp   rotations of joints from positions, for codecs/tempo/rotation_layer and geometry/kinematics.py
//   signals.cpp     residuals and linear prediction, for signals/ (signal_lanes.h, signal_prediction.h); signal_fitting.cpp
//                   chooses the predictors (signal_least_squares.h); signal_forms.cpp turns values into integers;
//                   signal_chunks.cpp decodes whole chunks (signal_records.h: bytes, signal_values.h: integers to values)
//   householder.cpp orthonormal bases stored as reflections, for stages/basis.py; householder.h makes the basis
//   ordered.cpp     linear algebra in a fixed order of operations, for codecs/tempo/models/ordered.py
//   marker_fitting.cpp    bones that markers sit on, for codecs/tempo/models/marker_fitting.py
//   clip_synthesis.cpp    positions of clips from integers, for codecs/hou2014/stream.py; cosine_series.h is the DCT
//   clip_quantiser.cpp    integers of coefficients, for codecs/hou2014/quantised_motion.py
//   clip_lengths.cpp      the best length of clips, for codecs/hou2014/clip_segmentation.py
//   bounded.cpp     corrections that stay valid for many frames, for stages/bounded.py
//   splines.cpp     natural cubic splines and key frames, for stages/spline.py; splines.h has the splines
//   motion_segments.cpp   segments from bytes to positions, for codecs/liu2006/decoding.py
//   ppca.cpp        segmentation by probabilistic PCA, for stages/segment.py
//   body_frames.cpp       poses to positions, for codecs/liu2006
//   positions.cpp   one pass over positions, for codecs/tempo and metrics/motion.py
//   varints.cpp     many varints at once, for fields/cursor.py
//   lzf.cpp         LZF decompression, for formats/lzf.py
//   chunk_codec.cpp whole chunks, for codecs/tempo/compiled_chunks.py; its parts are chunk_symbols.h (bytes to integers),
//                   chunk_synthesis.h (integers to positions), chunk_errors.h, chunk_analysis.h (positions to coefficients),
//                   chunk_quantiser.h (to integers) and chunk_packer.h (to bytes); coefficients.cpp shares contexts.h,
//                   bone_coordinates.cpp bone_coordinates.h
//   matching.cpp    registration of a body to points, for geometry/body_matching.py and limb_search.py; its parts are
//                   kd_tree.h (nearest points), nearest_data.h (those of template points), skinned_body.h (template and
//                   pose), nearest_links.h (candidate links), normal_equations.h (Gauss–Newton step), joint_limits.cpp
//                   (nearest allowed rotation), limb_search.h (random poses of a limb) and algebra3.h (vectors of 3,
//                   3 × 3 matrices)
//
// A file with kernels defines `void bind_NAME(nb::module_ &)`; list NAME in PARTS below. Python looks a kernel up by
// name (`mocodec.native.kernel`) and runs its NumPy code if there is none. If bytes depend on a kernel, it returns the
// same bits as NumPy: integers, or floats from the same operations in the same order.

#include <nanobind/nanobind.h>

namespace nb = nanobind;

#define PARTS(PART)                                                                                             \
    PART(entropy) PART(coefficients) PART(matching) PART(bone_directions) PART(lattice) PART(bit_arrays)   \
    PART(joint_rotations) PART(signals) PART(signal_fitting) PART(signal_chunks) PART(signal_forms)        \
    PART(varints) PART(chunk_codec) PART(bulk) PART(bone_coordinates) PART(point_octree) PART(cube_octree)                 \
    PART(point_colours) PART(colour_memory) PART(clustered_icp) PART(surface_memory) PART(splines) PART(householder)           \
    PART(point_smoothing) PART(positions) PART(link_surfaces) PART(state_stream) PART(body_frames) \
    PART(ordered) PART(lattice_neighbours) PART(marker_fitting)         \
    PART(reference_surface) PART(ppca) PART(point_choice) PART(lattice_frames) PART(clip_synthesis) PART(clip_lengths) PART(clip_quantiser) \
    PART(motion_segments) PART(bounded) PART(first_pose) PART(neighbours) PART(lzf)

#define DECLARE(name) void bind_##name(nb::module_ &);
PARTS(DECLARE)

#define BIND(name) bind_##name(m);
NB_MODULE(_native, m) {
    nb::set_leak_warnings(false);  // caches may outlive the module when the interpreter ends
    m.doc() = "The compiled accelerator of mocodec; docs/architecture.md says what it may do.";
    PARTS(BIND)
}
