// Decodes whole streams with one state in one call, for entropy/coder.py, _unpack_dense.

#include <nanobind/stl/optional.h>

#include "state_streams.h"

void bind_state_stream(nb::module_ &m) {
    using state_streams::StateStreams;
    nb::class_<StateStreams>(m, "StateStreams")
        .def(nb::init<StateStreams::Numbers, Input<int64_t, 2>, bool>())
        .def("add", &StateStreams::add)
        .def("has_long_ladder", [](const StateStreams &self, nb::bytes data) {
            return self.has_long_ladder(static_cast<const uint8_t *>(data.data()), data.size());
        })
        .def("unpack", &StateStreams::unpack);
}
