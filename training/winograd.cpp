// Convolutions of 3 x 3 by minimal filtering (Winograd 1980; Lavin and Gray 2016, F(4 x 4, 3 x 3)): a quarter of the products.
//
// A tile of 6 x 6 pixels makes 4 x 4 of the result: V = B' d B, M = sum over channels of U V with U = G g G', y = A' M A. The backward pass
// is the transpose of that, step by step: dM = A dy A', dU = V' dM, dV = dM U', dd = B dV B', dg = G' dU G.
// Layouts: pixels (sample, row, column, channel); kernels (output, row, column, input). Channels come in multiples of 32.

#include <torch/extension.h>

#include <algorithm>
#include <array>
#include <optional>
#include <vector>

namespace {

constexpr int64_t LANES = 16, PANEL = 32, TILE = 4, SEEN = 6, POSITIONS = SEEN * SEEN, BLOCK = 64;
using Vec = float __attribute__((vector_size(4 * LANES)));
using Anywhere = float __attribute__((vector_size(4 * LANES), aligned(4), may_alias));

Vec load(const float* from) { return *reinterpret_cast<const Anywhere*>(from); }
void store(float* to, Vec value) { *reinterpret_cast<Anywhere*>(to) = value; }
// Memory in whole cache lines.
torch::Tensor room(int64_t count) { return torch::empty({count}, torch::kFloat); }
Vec positive(Vec x) { return x > 0.0f ? x : Vec{}; }

// The transforms of one line of a tile.
struct ToV {  // B'
    static void apply(const Vec (&d)[6], Vec (&v)[6]) {
        const Vec even = d[4] - 4 * d[2], odd = d[3] - 4 * d[1], near = d[4] - d[2], far = 2 * (d[3] - d[1]);
        v[0] = 4 * d[0] - 5 * d[2] + d[4];
        v[1] = even + odd;
        v[2] = even - odd;
        v[3] = near + far;
        v[4] = near - far;
        v[5] = 4 * d[1] - 5 * d[3] + d[5];
    }
};
struct FromV {  // B
    static void apply(const Vec (&v)[6], Vec (&d)[6]) {
        const Vec s = v[1] + v[2], t = v[1] - v[2], p = v[3] + v[4], q = v[3] - v[4];
        d[0] = 4 * v[0];
        d[1] = 4 * v[5] - 4 * t - 2 * q;
        d[2] = -5 * v[0] - 4 * s - p;
        d[3] = -5 * v[5] + t + 2 * q;
        d[4] = v[0] + s + p;
        d[5] = v[5];
    }
};
struct FromM {  // A'
    static void apply(const Vec (&m)[6], Vec (&y)[4]) {
        const Vec s = m[1] + m[2], t = m[1] - m[2], p = m[3] + m[4], q = m[3] - m[4];
        y[0] = m[0] + s + p;
        y[1] = t + 2 * q;
        y[2] = s + 4 * p;
        y[3] = t + 8 * q + m[5];
    }
};
struct ToM {  // A
    static void apply(const Vec (&y)[4], Vec (&m)[6]) {
        const Vec even = y[0] + y[2], odd = y[1] + y[3], far_even = y[0] + 4 * y[2], far_odd = 2 * y[1] + 8 * y[3];
        m[0] = y[0];
        m[1] = even + odd;
        m[2] = even - odd;
        m[3] = far_even + far_odd;
        m[4] = far_even - far_odd;
        m[5] = y[3];
    }
};
struct ToU {  // G
    static void apply(const Vec (&g)[3], Vec (&u)[6]) {
        const Vec even = (g[0] + g[2]) / -6, odd = g[1] / -6, far_even = g[0] / 24 + g[2] / 6, far_odd = g[1] / 12;
        u[0] = g[0] / 4;
        u[1] = even + odd;
        u[2] = even - odd;
        u[3] = far_even + far_odd;
        u[4] = far_even - far_odd;
        u[5] = g[2];
    }
};
struct FromU {  // G'
    static void apply(const Vec (&u)[6], Vec (&g)[3]) {
        const Vec s = (u[1] + u[2]) / -6, t = (u[1] - u[2]) / -6, p = u[3] + u[4], q = u[3] - u[4];
        g[0] = u[0] / 4 + s + p / 24;
        g[1] = t + q / 12;
        g[2] = s + p / 6 + u[5];
    }
};

// A transform of a tile's columns and then of its rows.
template <class Line, int FROM, int TO>
void both(const Vec (&in)[FROM][FROM], Vec (&out)[TO][TO]) {
    Vec half[FROM][TO];
    for (int j = 0; j < FROM; ++j) {
        Vec column[FROM];
        for (int i = 0; i < FROM; ++i) column[i] = in[i][j];
        Line::apply(column, half[j]);
    }
    for (int i = 0; i < TO; ++i) {
        Vec row[FROM];
        for (int j = 0; j < FROM; ++j) row[j] = half[j][i];
        Line::apply(row, out[i]);
    }
}

// C (ROWS x 32) = A (ROWS x k) B (k x 32), or added to what C has.
template <int ROWS>
void product(const float* a, int64_t row, int64_t along, const float* b, int64_t b_along, float* c, int64_t c_row, int64_t k, bool add) {
    Vec sum[ROWS][2];
    for (int r = 0; r < ROWS; ++r)
        for (int h = 0; h < 2; ++h) sum[r][h] = add ? load(c + r * c_row + h * LANES) : Vec{};
    for (int64_t i = 0; i < k; ++i, a += along, b += b_along) {
        const Vec left = load(b), right = load(b + LANES);
#pragma GCC unroll 8
        for (int r = 0; r < ROWS; ++r) {
            const float one = a[r * row];
            sum[r][0] += one * left;
            sum[r][1] += one * right;
        }
    }
    for (int r = 0; r < ROWS; ++r)
        for (int h = 0; h < 2; ++h) store(c + r * c_row + h * LANES, sum[r][h]);
}

// C (rows x columns) = A (rows x k) B, or added to what C has; B comes in panels of 32 columns.
void products(int64_t rows, int64_t columns, int64_t k, const float* a, int64_t row, int64_t along, const float* b, int64_t b_panel, int64_t b_along, float* c, int64_t c_row, bool add) {
    for (int64_t panel = 0; panel < columns / PANEL; ++panel, b += b_panel, c += PANEL) {
        int64_t r = 0;
        for (; r + 8 <= rows; r += 8) product<8>(a + r * row, row, along, b, b_along, c + r * c_row, c_row, k, add);
        for (; r < rows; ++r) product<1>(a + r * row, row, along, b, b_along, c + r * c_row, c_row, k, add);
    }
}

// The distance of planes, and of rows within them, is odd in cache lines: a power of two would put all of a tile into the same few sets.
int64_t apart(int64_t floats) { return floats / LANES % 2 ? floats : floats + LANES; }

// Planes of one value per tile and channel, for the 36 positions.
struct Planes {
    int64_t row, plane;
    torch::Tensor values;
    float* first;
    Planes(int64_t tiles, int64_t channels) : row(apart(channels)), plane(apart(tiles * row)), values(room(POSITIONS * plane)), first(values.data_ptr<float>()) {}
    float* at(int64_t position, int64_t tile = 0) { return first + position * plane + tile * row; }
    void put(const Vec (&tile)[6][6], int64_t number, int64_t channel) {
        for (int i = 0; i < SEEN; ++i)
            for (int j = 0; j < SEEN; ++j) store(at(i * SEEN + j, number) + channel, tile[i][j]);
    }
    void get(Vec (&tile)[6][6], int64_t number, int64_t channel) {
        for (int i = 0; i < SEEN; ++i)
            for (int j = 0; j < SEEN; ++j) tile[i][j] = load(at(i * SEEN + j, number) + channel);
    }
};

// Kernels U (36 `apart`, panels of 32 channels, `from` channels, 32) of w, whose pixels and `from` channels are that far apart.
torch::Tensor transformed(const float* w, int64_t pixel, int64_t row, int64_t from, int64_t panels) {
    const int64_t plane = apart(from * panels * PANEL);
    auto result = room(POSITIONS * plane);
    float* u = result.data_ptr<float>();
    for (int64_t panel = 0; panel < panels; ++panel)
        for (int64_t in = 0; in < from; ++in)
            for (int64_t half = 0; half < PANEL; half += LANES) {
                Vec g[3][3], out[6][6];
                for (int i = 0; i < 3; ++i)
                    for (int j = 0; j < 3; ++j) g[i][j] = load(w + (i * 3 + j) * pixel + in * row + panel * PANEL + half);
                both<ToU, 3, 6>(g, out);
                for (int p = 0; p < POSITIONS; ++p) store(u + p * plane + (panel * from + in) * PANEL + half, out[p / SEEN][p % SEEN]);
            }
    return result;
}

// The tiles of images of one size.
struct Grid {
    int64_t height, width, rows, columns;
    Grid(int64_t height, int64_t width) : height(height), width(width), rows(height / TILE), columns(width / TILE) {}
    int64_t tiles() const { return rows * columns; }
    // Samples that are worked on together.
    int64_t together() const { return std::max<int64_t>(1, BLOCK / tiles()); }
    // Calls with (number of the tile, its sample, its first row and column of the result, channel), for every LANES-th channel.
    template <class F>
    void each(int64_t first, int64_t samples, int64_t channels, F f) const {
        for (int64_t s = 0, t = 0; s < samples; ++s)
            for (int64_t i = 0; i < rows; ++i)
                for (int64_t j = 0; j < columns; ++j, ++t)
                    for (int64_t c = 0; c < channels; c += LANES) f(t, first + s, i * TILE, j * TILE, c);
    }
    int64_t pixel(int64_t channels, int64_t s, int64_t i, int64_t j) const { return ((s * height + i) * width + j) * channels; }
    bool inside(int64_t i, int64_t j) const { return i >= 0 && j >= 0 && i < height && j < width; }
};

void fill_v(Planes& v, const Grid& grid, const float* x, int64_t channels, int64_t first, int64_t samples) {
    grid.each(first, samples, channels, [&](int64_t t, int64_t s, int64_t top, int64_t left, int64_t c) {
        Vec d[6][6], out[6][6];
        for (int i = 0; i < SEEN; ++i)
            for (int j = 0; j < SEEN; ++j) {
                const int64_t row = top + i - 1, column = left + j - 1;
                d[i][j] = grid.inside(row, column) ? positive(load(x + grid.pixel(channels, s, row, column) + c)) : Vec{};
            }
        both<ToV, 6, 6>(d, out);
        v.put(out, t, c);
    });
}

struct Sizes {
    int64_t samples, height, width, inputs, outputs;
    Sizes(const torch::Tensor& x, const torch::Tensor& w) : samples(x.size(0)), height(x.size(1)), width(x.size(2)), inputs(x.size(3)), outputs(w.size(0)) {
        TORCH_CHECK(x.is_contiguous() && w.is_contiguous() && x.scalar_type() == torch::kFloat && w.scalar_type() == torch::kFloat, "contiguous floats");
        TORCH_CHECK(w.size(1) == 3 && w.size(2) == 3 && w.size(3) == inputs, "kernels (outputs, 3, 3, inputs)");
        TORCH_CHECK(height % TILE == 0 && width % TILE == 0 && inputs % PANEL == 0 && outputs % PANEL == 0, "sizes of whole tiles and panels");
    }
};

}  // namespace

// y = conv(relu(x), w) + bias, and + `rest` where given.
torch::Tensor forward(torch::Tensor x, torch::Tensor w, torch::Tensor bias, std::optional<torch::Tensor> rest) {
    const Sizes z(x, w);
    const Grid grid(z.height, z.width);
    auto y = torch::empty({z.samples, z.height, z.width, z.outputs}, x.options());
    const auto turned = w.view({z.outputs, 9 * z.inputs}).t().contiguous();
    const auto kernels = transformed(turned.data_ptr<float>(), z.inputs * z.outputs, z.outputs, z.inputs, z.outputs / PANEL);
    const float* u = kernels.data_ptr<float>();
    const int64_t plane = apart(z.inputs * z.outputs);
    const float *from = x.data_ptr<float>(), *shift = bias.data_ptr<float>(), *kept = rest ? rest->data_ptr<float>() : nullptr;
    float* to = y.data_ptr<float>();
    at::parallel_for(0, z.samples, grid.together(), [&](int64_t begin, int64_t end) {
        Planes v(grid.tiles() * grid.together(), z.inputs), m(grid.tiles() * grid.together(), z.outputs);
        for (int64_t first = begin; first < end; first += grid.together()) {
            const int64_t samples = std::min(grid.together(), end - first), tiles = samples * grid.tiles();
            fill_v(v, grid, from, z.inputs, first, samples);
            for (int64_t p = 0; p < POSITIONS; ++p)
                products(tiles, z.outputs, z.inputs, v.at(p), v.row, 1, u + p * plane, z.inputs * PANEL, PANEL, m.at(p), m.row, false);
            grid.each(first, samples, z.outputs, [&](int64_t t, int64_t s, int64_t top, int64_t left, int64_t c) {
                Vec tile[6][6], out[4][4];
                m.get(tile, t, c);
                both<FromM, 6, 4>(tile, out);
                const Vec b = load(shift + c);
                for (int i = 0; i < TILE; ++i)
                    for (int j = 0; j < TILE; ++j) {
                        const int64_t at = grid.pixel(z.outputs, s, top + i, left + j) + c;
                        store(to + at, out[i][j] + b + (kept ? load(kept + at) : Vec{}));
                    }
            });
        }
    });
    return y;
}

// Gradients in x, w and the bias, given that in y.
std::array<torch::Tensor, 3> backward(torch::Tensor x, torch::Tensor w, torch::Tensor dy) {
    const Sizes z(x, w);
    const Grid grid(z.height, z.width);
    TORCH_CHECK(dy.is_contiguous() && dy.scalar_type() == torch::kFloat && dy.numel() == z.samples * z.height * z.width * z.outputs, "a gradient like y");
    auto dx = torch::empty_like(x), dw = torch::empty_like(w);
    const auto kernels = transformed(w.data_ptr<float>(), z.inputs, 9 * z.inputs, z.outputs, z.inputs / PANEL);
    const float* u = kernels.data_ptr<float>();
    const int64_t plane = apart(z.inputs * z.outputs);
    const float *from = x.data_ptr<float>(), *error = dy.data_ptr<float>();
    float* to = dx.data_ptr<float>();
    // One of each thread, added in their order: the same result every time.
    std::vector<torch::Tensor> parts(at::get_num_threads());
    at::parallel_for(0, z.samples, grid.together(), [&](int64_t begin, int64_t end) {
        Planes v(grid.tiles() * grid.together(), z.inputs), m(grid.tiles() * grid.together(), z.outputs);
        // After the kernels, the bias.
        auto part = room(POSITIONS * plane + z.outputs);
        float *own = part.data_ptr<float>(), *shift = own + POSITIONS * plane;
        std::fill_n(shift, z.outputs, 0.0f);
        std::fill_n(to + begin * z.height * z.width * z.inputs, (end - begin) * z.height * z.width * z.inputs, 0.0f);
        for (int64_t first = begin; first < end; first += grid.together()) {
            const int64_t samples = std::min(grid.together(), end - first), tiles = samples * grid.tiles();
            fill_v(v, grid, from, z.inputs, first, samples);
            grid.each(first, samples, z.outputs, [&](int64_t t, int64_t s, int64_t top, int64_t left, int64_t c) {
                Vec tile[4][4], out[6][6];
                for (int i = 0; i < TILE; ++i)
                    for (int j = 0; j < TILE; ++j) tile[i][j] = load(error + grid.pixel(z.outputs, s, top + i, left + j) + c);
                both<ToM, 4, 6>(tile, out);
                m.put(out, t, c);
                // The sum of the tile.
                store(shift + c, load(shift + c) + out[1][1]);
            });
            for (int64_t p = 0; p < POSITIONS; ++p) {
                products(z.outputs, z.inputs, tiles, m.at(p), 1, m.row, v.at(p), PANEL, v.row, own + p * plane, z.inputs, first > begin);
                // V has served, and makes room for its gradient.
                products(tiles, z.inputs, z.outputs, m.at(p), m.row, 1, u + p * plane, z.outputs * PANEL, PANEL, v.at(p), v.row, false);
            }
            grid.each(first, samples, z.inputs, [&](int64_t t, int64_t s, int64_t top, int64_t left, int64_t c) {
                Vec tile[6][6], out[6][6];
                v.get(tile, t, c);
                both<FromV, 6, 6>(tile, out);
                for (int i = 0; i < SEEN; ++i)
                    for (int j = 0; j < SEEN; ++j) {
                        const int64_t row = top + i - 1, column = left + j - 1;
                        if (!grid.inside(row, column)) continue;
                        const int64_t at = grid.pixel(z.inputs, s, row, column) + c;
                        store(to + at, load(to + at) + (load(from + at) > 0.0f ? out[i][j] : Vec{}));
                    }
            });
        }
        parts[at::get_thread_num()] = part;
    });
    torch::Tensor total;
    for (const auto& part : parts) {
        if (part.defined()) total = total.defined() ? total.add_(part) : part;
    }
    const float* summed = total.data_ptr<float>();
    float* to_w = dw.data_ptr<float>();
    for (int64_t out = 0; out < z.outputs; ++out)
        for (int64_t in = 0; in < z.inputs; in += LANES) {
            Vec tile[6][6], g[3][3];
            for (int p = 0; p < POSITIONS; ++p) tile[p / SEEN][p % SEEN] = load(summed + p * plane + out * z.inputs + in);
            both<FromU, 6, 3>(tile, g);
            for (int i = 0; i < 3; ++i)
                for (int j = 0; j < 3; ++j) store(to_w + ((out * 3 + i) * 3 + j) * z.inputs + in, g[i][j]);
        }
    return {dx, dw, total.slice(0, POSITIONS * plane).clone()};
}

PYBIND11_MODULE(TORCH_EXTENSION_NAME, module) {
    module.def("forward", &forward);
    module.def("backward", &backward);
}
