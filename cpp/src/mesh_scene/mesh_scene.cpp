// SPDX-License-Identifier: Apache-2.0
#include "geraf2/mesh_scene.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <limits>
#include <memory>
#include <numbers>
#include <numeric>
#include <span>
#include <string>
#include <vector>

#include "embree.hpp"
#include "geraf2/error.hpp"
#include "geraf2/types.hpp"

namespace geraf2 {
namespace {

using Vec = Vec3<double>;

Vec operator-(const Vec& a, const Vec& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
Vec operator+(const Vec& a, const Vec& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
Vec operator*(double s, const Vec& a) { return {s * a.x, s * a.y, s * a.z}; }
double dot(const Vec& a, const Vec& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
Vec cross(const Vec& a, const Vec& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
double norm(const Vec& a) { return std::sqrt(dot(a, a)); }
/// a over its length, for any finite a but zero: the square of the length may under- or overflow.
Vec unit(const Vec& a) {
    const double largest = std::max({std::abs(a.x), std::abs(a.y), std::abs(a.z)});
    const Vec scaled{a.x / largest, a.y / largest, a.z / largest};
    return (1.0 / norm(scaled)) * scaled;
}

Vec load(std::span<const double> rows, index_t row) {
    const auto i = static_cast<std::size_t>(3 * row);
    return {rows[i], rows[i + 1], rows[i + 2]};
}

// The filter sees the query's context; deriving from it carries the list of faces along.
struct GatherContext {
    QueryContext base; // first member: Embree hands its address back to the filter
    std::vector<unsigned>* faces = nullptr;
};

// Records the face and rejects the hit, so that traversal continues.
void gather_faces(const RTCFilterFunctionNArguments* args) {
    auto* gather = reinterpret_cast<GatherContext*>(args->context);
    gather->faces->push_back(RTCHitN_primID(args->hit, args->N, 0));
    args->valid[0] = 0;
}

/// Neighbours in a list that one thread works on in order.
constexpr index_t chunk_size = 64;

/// Runs body(i) for all i; an exception in one of them is rethrown after the loop.
template <class Body>
void parallel_for(index_t count, int num_threads, const Body& body) {
    std::exception_ptr error;
#pragma omp parallel for schedule(dynamic, chunk_size) num_threads(num_threads)
    for (index_t i = 0; i < count; ++i) {
        try {
            body(i);
        } catch (...) {
#pragma omp critical(geraf2_mesh_scene_error)
            if (!error) {
                error = std::current_exception();
            }
        }
    }
    if (error) {
        std::rethrow_exception(error);
    }
}

// Closest point of triangle (a, b, c) to p by the seven Voronoi regions of the triangle.
Vec closest_on_triangle(const Vec& p, const Vec& a, const Vec& b, const Vec& c) {
    const Vec ab = b - a;
    const Vec ac = c - a;
    const Vec ap = p - a;
    const double d1 = dot(ab, ap);
    const double d2 = dot(ac, ap);
    if (d1 <= 0.0 && d2 <= 0.0) {
        return a;
    }
    const Vec bp = p - b;
    const double d3 = dot(ab, bp);
    const double d4 = dot(ac, bp);
    if (d3 >= 0.0 && d4 <= d3) {
        return b;
    }
    const double vc = d1 * d4 - d3 * d2;
    if (vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0) {
        return a + (d1 / (d1 - d3)) * ab;
    }
    const Vec cp = p - c;
    const double d5 = dot(ab, cp);
    const double d6 = dot(ac, cp);
    if (d6 >= 0.0 && d5 <= d6) {
        return c;
    }
    const double vb = d5 * d2 - d1 * d6;
    if (vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0) {
        return a + (d2 / (d2 - d6)) * ac;
    }
    const double va = d3 * d6 - d5 * d4;
    if (va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0) {
        return b + ((d4 - d3) / ((d4 - d3) + (d5 - d6))) * (c - b);
    }
    const double sum = va + vb + vc;
    if (!(sum > 0.0)) { // zero area: the three edges above already covered it
        return a;
    }
    return a + (vb / sum) * ab + (vc / sum) * ac;
}

// Directions of the parity rays: fixed, and oblique to every plane a box or grid mesh is made of.
constexpr std::array<Vec, 5> parity_directions{{{0.5377, 0.2113, 0.8163},
                                                {-0.7243, 0.5119, 0.4619},
                                                {0.3157, -0.8853, 0.3387},
                                                {-0.4421, -0.3659, -0.8190},
                                                {0.8377, 0.3413, -0.4263}}};

} // namespace

struct MeshScene::Impl {
    DevicePtr device;
    ScenePtr scene;
    std::vector<Vec> vertices; // in double, relative to center
    std::vector<std::array<unsigned, 3>> faces;
    Vec center;           // Embree computes in float: coordinates are kept small
    double merge_m = 0.0; // crossings of one sign closer than this are one

    [[nodiscard]] std::array<Vec, 3> corners(unsigned face) const {
        const auto& f = faces[face];
        return {vertices[f[0]], vertices[f[1]], vertices[f[2]]};
    }

    // Distance along `direction` to the face's plane, in double; `fallback` where the ray grazes.
    [[nodiscard]] double plane_distance(const Vec& origin, const Vec& direction, unsigned face,
                                        double fallback) const {
        const auto [a, b, c] = corners(face);
        const Vec normal = cross(b - a, c - a);
        const double along = dot(normal, direction);
        // Below 1e-6 of the normal's length the float hit is the better conditioned one.
        if (std::abs(along) <= 1e-6 * norm(normal)) {
            return fallback;
        }
        return dot(normal, a - origin) / along;
    }

    /// Rounded up: float rounds the corners to half of merge_m, the point to 6e-8 of its distance,
    /// and must never prune a face that is near enough in double.
    [[nodiscard]] float search_radius(double distance) const {
        return static_cast<float>(distance * (1.0 + 1e-6) + 4.0 * merge_m);
    }

    [[nodiscard]] static RTCRay make_ray(const Vec& origin, const Vec& direction, double t_near,
                                         double t_far) {
        RTCRay ray{};
        ray.org_x = static_cast<float>(origin.x);
        ray.org_y = static_cast<float>(origin.y);
        ray.org_z = static_cast<float>(origin.z);
        ray.dir_x = static_cast<float>(direction.x);
        ray.dir_y = static_cast<float>(direction.y);
        ray.dir_z = static_cast<float>(direction.z);
        ray.tnear = static_cast<float>(t_near);
        ray.tfar = static_cast<float>(t_far);
        ray.mask = ~0U;
        return ray;
    }

    // Faces met by the ray, each once.
    void gather(const Vec& origin, const Vec& direction, std::vector<unsigned>& met) const {
        met.clear();
        RTCRayHit query{};
        query.ray = make_ray(origin, direction, 0.0, std::numeric_limits<double>::infinity());
        query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
        GatherContext gather_context{};
        init_context(gather_context.base);
        gather_context.faces = &met;
#if GERAF2_EMBREE_MAJOR >= 4
        RTCIntersectArguments args;
        rtcInitIntersectArguments(&args);
        args.context = &gather_context.base;
        args.flags =
            static_cast<RTCRayQueryFlags>(args.flags | RTC_RAY_QUERY_FLAG_INVOKE_ARGUMENT_FILTER);
        args.filter = gather_faces;
        rtcIntersect1(scene.get(), &query, &args);
#else
        gather_context.base.filter = gather_faces;
        rtcIntersect1(scene.get(), &gather_context.base, &query);
#endif
        std::sort(met.begin(), met.end());
        met.erase(std::unique(met.begin(), met.end()), met.end());
    }

    /// Distance to the first face along a ray of unit direction, +inf without one.
    [[nodiscard]] double closest(const Vec& origin, const Vec& direction, unsigned& face) const {
        RTCRayHit query{};
        query.ray = make_ray(origin, direction, 0.0, std::numeric_limits<double>::infinity());
        query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
        query.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
#if GERAF2_EMBREE_MAJOR >= 4
        rtcIntersect1(scene.get(), &query);
#else
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        rtcIntersect1(scene.get(), &context, &query);
#endif
        if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) {
            return std::numeric_limits<double>::infinity();
        }
        face = query.hit.primID;
        // Refined, a face that the origin touches may lie behind it by a rounding.
        return std::max(
            0.0, plane_distance(origin, direction, face, static_cast<double>(query.ray.tfar)));
    }

    struct Crossing {
        double distance;
        bool entering;
    };

    void cross_ray(const Vec& origin, const Vec& direction, std::vector<unsigned>& met,
                   std::vector<Crossing>& out) const {
        gather(origin, direction, met);
        out.clear();
        for (const unsigned face : met) {
            const auto [a, b, c] = corners(face);
            const Vec normal = cross(b - a, c - a);
            const double along = dot(normal, direction);
            if (std::abs(along) <= 1e-9 * norm(normal)) {
                continue; // in the plane of the face: its neighbours decide
            }
            out.push_back({std::max(0.0, dot(normal, a - origin) / along), along < 0.0});
        }
        std::sort(out.begin(), out.end(),
                  [](const Crossing& a, const Crossing& b) { return a.distance < b.distance; });
        // Two faces that share the edge or corner which the ray meets report it twice.
        const auto same = [this](const Crossing& a, const Crossing& b) {
            return a.entering == b.entering && b.distance - a.distance <= merge_m;
        };
        out.erase(std::unique(out.begin(), out.end(), same), out.end());
    }

    [[nodiscard]] bool inside(const Vec& point, std::vector<unsigned>& met,
                              std::vector<Crossing>& crossing) const {
        int votes = 0;
        for (const Vec& direction : parity_directions) {
            cross_ray(point, (1.0 / norm(direction)) * direction, met, crossing);
            int net = 0;
            for (const Crossing& c : crossing) {
                net += c.entering ? -1 : 1;
            }
            votes += net != 0 ? 1 : -1; // also right for a mesh wound inward as a whole
        }
        return votes > 0;
    }

    [[nodiscard]] double distance_to_face(const Vec& point, unsigned face) const {
        const auto [a, b, c] = corners(face);
        return norm(closest_on_triangle(point, a, b, c) - point);
    }

    /// Distance to the nearest face. `face` is one that may be near, or `no_face`, and becomes the
    /// nearest: the search begins there.
    [[nodiscard]] double distance(const Vec& point, unsigned& face) const;

    /// Distances of many points: the search begins at the nearest face of the point before, which
    /// shortens it where neighbours are consecutive.
    template <class Finish>
    void distances(std::span<const double> points, int num_threads, Finish finish,
                   std::span<double> out) const;

    void open();   // device and empty scene
    void commit(); // vertices and faces handed to Embree, hierarchy built
};

namespace {

constexpr unsigned no_face = RTC_INVALID_GEOMETRY_ID;

struct NearestFace {
    const void* impl = nullptr;
    Vec point;
    double distance = std::numeric_limits<double>::infinity();
    unsigned face = no_face;
};

} // namespace

double MeshScene::Impl::distance(const Vec& point, unsigned& face) const {
    NearestFace nearest{this, point};
    if (face != no_face) {
        const double known = distance_to_face(point, face);
        if (known < nearest.distance) { // not where a face without area has no distance
            nearest = {this, point, known, face};
        }
    }
    RTCPointQuery query{};
    query.x = static_cast<float>(point.x);
    query.y = static_cast<float>(point.y);
    query.z = static_cast<float>(point.z);
    query.radius = search_radius(nearest.distance);
    RTCPointQueryContext context;
    rtcInitPointQueryContext(&context);
    rtcPointQuery(
        scene.get(), &query, &context,
        [](RTCPointQueryFunctionArguments* args) {
            auto* best = static_cast<NearestFace*>(args->userPtr);
            const auto* self = static_cast<const Impl*>(best->impl);
            const double d = self->distance_to_face(best->point, args->primID);
            if (!(d < best->distance)) {
                return false;
            }
            best->distance = d;
            best->face = args->primID;
            args->query->radius = self->search_radius(d);
            return true;
        },
        &nearest);
    face = nearest.face;
    return nearest.distance;
}

template <class Finish>
void MeshScene::Impl::distances(std::span<const double> points, int num_threads, Finish finish,
                                std::span<double> out) const {
    parallel_for(static_cast<index_t>(out.size()), num_threads, [&](index_t i) {
        const Vec point = load(points, i) - center;
        double same_side = 0.0; // a distance of the same sign as this one; zero without one
        thread_local unsigned face = no_face; // nearest to the point before
        // The first of a chunk follows one that another thread may be writing.
        if (i % chunk_size == 0) {
            face = no_face;
        } else {
            const double before = out[static_cast<std::size_t>(i - 1)];
            const double step = norm(point - (load(points, i - 1) - center));
            // No face is between two points that are nearer to each other than to any face.
            same_side = step * (1.0 + 1e-6) + merge_m < std::abs(before) ? before : 0.0;
        }
        out[static_cast<std::size_t>(i)] = finish(point, distance(point, face), same_side);
    });
}

void MeshScene::Impl::open() {
    device.reset(rtcNewDevice(nullptr));
    if (!device) {
        throw_error(rtcGetDeviceError(nullptr), "opening the device");
    }
    scene.reset(rtcNewScene(device.get()));
    throw_device_error(device.get(), "making the scene");
#if GERAF2_EMBREE_MAJOR >= 4
    constexpr auto filter = RTC_SCENE_FLAG_FILTER_FUNCTION_IN_ARGUMENTS;
#else
    constexpr auto filter = RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION;
#endif
    rtcSetSceneFlags(scene.get(), static_cast<RTCSceneFlags>(RTC_SCENE_FLAG_ROBUST | filter));
}

void MeshScene::Impl::commit() {
    const GeometryPtr geometry(rtcNewGeometry(device.get(), RTC_GEOMETRY_TYPE_TRIANGLE));
    throw_device_error(device.get(), "making the mesh");
    auto* points = static_cast<float*>(
        rtcSetNewGeometryBuffer(geometry.get(), RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                3 * sizeof(float), vertices.size()));
    auto* triangles = static_cast<unsigned*>(
        rtcSetNewGeometryBuffer(geometry.get(), RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                3 * sizeof(unsigned), faces.size()));
    throw_device_error(device.get(), "allocating the mesh");
    for (const Vec& v : vertices) {
        *points++ = static_cast<float>(v.x);
        *points++ = static_cast<float>(v.y);
        *points++ = static_cast<float>(v.z);
    }
    for (const auto& face : faces) {
        triangles = std::copy(face.begin(), face.end(), triangles);
    }
    rtcCommitGeometry(geometry.get());
    rtcAttachGeometry(scene.get(), geometry.get());
    rtcCommitScene(scene.get());
    throw_device_error(device.get(), "building the hierarchy");
}

MeshScene::MeshScene(std::span<const double> vertices, std::span<const index_t> faces)
    : impl_(std::make_unique<Impl>()) {
    const auto n_vertices = static_cast<index_t>(vertices.size() / 3);
    Impl& s = *impl_;
    constexpr double inf = std::numeric_limits<double>::infinity();
    Vec low{inf, inf, inf};
    Vec high{-inf, -inf, -inf};
    for (index_t i = 0; i < n_vertices; ++i) {
        const Vec v = load(vertices, i);
        low = {std::min(low.x, v.x), std::min(low.y, v.y), std::min(low.z, v.z)};
        high = {std::max(high.x, v.x), std::max(high.y, v.y), std::max(high.z, v.z)};
    }
    s.center = 0.5 * (low + high);
    s.merge_m = 1e-7 * norm(high - low);
    for (index_t i = 0; i < n_vertices; ++i) {
        s.vertices.push_back(load(vertices, i) - s.center);
    }
    for (std::size_t i = 0; i + 2 < faces.size(); i += 3) {
        s.faces.push_back({static_cast<unsigned>(faces[i]), static_cast<unsigned>(faces[i + 1]),
                           static_cast<unsigned>(faces[i + 2])});
    }
    s.open();
    s.commit();
}

MeshScene::~MeshScene() = default;
MeshScene::MeshScene(MeshScene&&) noexcept = default;
MeshScene& MeshScene::operator=(MeshScene&&) noexcept = default;

void MeshScene::closest_hit(std::span<const double> origins, std::span<const double> directions,
                            std::span<double> distances, std::span<index_t> hit_faces,
                            int num_threads) const {
    parallel_for(static_cast<index_t>(distances.size()), num_threads, [&](index_t i) {
        const auto out = static_cast<std::size_t>(i);
        unsigned face = no_face;
        const Vec origin = load(origins, i) - impl_->center;
        distances[out] = impl_->closest(origin, unit(load(directions, i)), face);
        hit_faces[out] = face == no_face ? -1 : static_cast<index_t>(face);
    });
}

void MeshScene::first_meetings(std::span<const double> origins, std::span<const double> targets,
                               std::span<double> places, int num_threads) const {
    parallel_for(static_cast<index_t>(places.size() / 3), num_threads, [&](index_t i) {
        const Vec origin = load(origins, i);
        const Vec way = load(targets, i) - origin;
        const double length = norm(way);
        unsigned face = no_face;
        const double hit =
            length > 0.0 ? impl_->closest(origin - impl_->center, (1.0 / length) * way, face) : 0.0;
        const Vec place = hit < length ? origin + (hit / length) * way : origin + way;
        std::copy_n(std::array{place.x, place.y, place.z}.data(), 3, places.data() + 3 * i);
    });
}

void MeshScene::spans(std::span<const double> origins, std::span<const double> directions,
                      bool wound_outward, std::span<double> near, std::span<double> far,
                      int num_threads) const {
    parallel_for(static_cast<index_t>(near.size()), num_threads, [&](index_t i) {
        thread_local std::vector<unsigned> met;
        thread_local std::vector<Impl::Crossing> crossing;
        impl_->cross_ray(load(origins, i) - impl_->center, unit(load(directions, i)), met,
                         crossing);
        int depth = 0;
        int lowest = 0;
        for (const Impl::Crossing& c : crossing) {
            depth += c.entering == wound_outward ? 1 : -1;
            lowest = std::min(lowest, depth);
        }
        depth = -lowest; // above zero where the ray starts inside: more exits than entries
        double& first = near[static_cast<std::size_t>(i)] = depth > 0 ? 0.0 : HUGE_VAL;
        double& last = far[static_cast<std::size_t>(i)] = -HUGE_VAL;
        for (const Impl::Crossing& c : crossing) {
            depth += c.entering == wound_outward ? 1 : -1;
            if (c.entering == wound_outward) {
                first = std::min(first, c.distance);
            } else if (depth == 0) {
                last = c.distance;
            }
        }
    });
}

void MeshScene::occluded(std::span<const double> origins, std::span<const double> targets,
                         double margin_m, std::span<std::uint8_t> blocked, int num_threads) const {
    const Impl& s = *impl_;
    parallel_for(static_cast<index_t>(blocked.size()), num_threads, [&](index_t i) {
        const Vec origin = load(origins, i) - s.center;
        const Vec along = load(targets, i) - s.center - origin;
        const double length = norm(along);
        const auto out = static_cast<std::size_t>(i);
        if (length <= 2.0 * margin_m) {
            blocked[out] = 0;
            return;
        }
        RTCRay ray = Impl::make_ray(origin, (1.0 / length) * along, margin_m, length - margin_m);
#if GERAF2_EMBREE_MAJOR >= 4
        rtcOccluded1(s.scene.get(), &ray);
#else
        RTCIntersectContext context;
        rtcInitIntersectContext(&context);
        rtcOccluded1(s.scene.get(), &context, &ray);
#endif
        blocked[out] = ray.tfar < 0.0F ? 1 : 0; // Embree marks a hit with tfar = -inf
    });
}

Crossings MeshScene::crossings(std::span<const double> origins, std::span<const double> directions,
                               int num_threads) const {
    const Impl& s = *impl_;
    const auto n_rays = static_cast<index_t>(origins.size() / 3);
    const auto n_chunks = static_cast<std::size_t>((n_rays + chunk_size - 1) / chunk_size);
    std::vector<std::vector<Impl::Crossing>> found(n_chunks);
    Crossings out;
    out.offsets.resize(static_cast<std::size_t>(n_rays) + 1, 0);
    parallel_for(n_rays, num_threads, [&](index_t i) {
        thread_local std::vector<unsigned> met;
        thread_local std::vector<Impl::Crossing> crossing;
        // Of a chunk, which is one thread's, ray after ray; handed over at its end, as the lists of
        // neighbouring chunks share cache lines.
        thread_local std::vector<Impl::Crossing> all;
        if (i % chunk_size == 0) {
            all.clear();
        }
        s.cross_ray(load(origins, i) - s.center, unit(load(directions, i)), met, crossing);
        all.insert(all.end(), crossing.begin(), crossing.end());
        out.offsets[static_cast<std::size_t>(i) + 1] = static_cast<index_t>(crossing.size());
        if ((i + 1) % chunk_size == 0 || i + 1 == n_rays) {
            found[static_cast<std::size_t>(i / chunk_size)] = all;
        }
    });
    std::partial_sum(out.offsets.begin(), out.offsets.end(), out.offsets.begin());
    out.distances.resize(static_cast<std::size_t>(out.offsets.back()));
    out.entering.resize(out.distances.size());
    parallel_for(n_rays, num_threads, [&](index_t i) {
        const index_t first = out.offsets[static_cast<std::size_t>(i / chunk_size * chunk_size)];
        for (index_t k = out.offsets[static_cast<std::size_t>(i)];
             k < out.offsets[static_cast<std::size_t>(i) + 1]; ++k) {
            const Impl::Crossing& c = found[static_cast<std::size_t>(i / chunk_size)]
                                           [static_cast<std::size_t>(k - first)];
            out.distances[static_cast<std::size_t>(k)] = c.distance;
            out.entering[static_cast<std::size_t>(k)] = c.entering ? 1 : 0;
        }
    });
    return out;
}

void MeshScene::distance(std::span<const double> points, std::span<double> distances,
                         int num_threads) const {
    impl_->distances(
        points, num_threads, [](const Vec&, double d, double) { return d; }, distances);
}

void MeshScene::signed_distance(std::span<const double> points, std::span<double> distances,
                                int num_threads) const {
    const Impl& s = *impl_;
    const auto sign = [&s](const Vec& point, double d, double same_side) {
        if (same_side != 0.0) {
            return std::copysign(d, same_side);
        }
        thread_local std::vector<unsigned> met;
        thread_local std::vector<Impl::Crossing> crossing;
        return s.inside(point, met, crossing) ? -d : d;
    };
    s.distances(points, num_threads, sign, distances);
}

void MeshScene::contains(std::span<const double> points, std::span<std::uint8_t> inside,
                         int num_threads) const {
    const Impl& s = *impl_;
    parallel_for(static_cast<index_t>(inside.size()), num_threads, [&](index_t i) {
        thread_local std::vector<unsigned> met;
        thread_local std::vector<Impl::Crossing> crossing;
        const bool is_inside = s.inside(load(points, i) - s.center, met, crossing);
        inside[static_cast<std::size_t>(i)] = is_inside ? 1 : 0;
    });
}

void MeshScene::winding_number(std::span<const double> points, std::span<double> winding,
                               int num_threads) const {
    const Impl& s = *impl_;
    parallel_for(static_cast<index_t>(winding.size()), num_threads, [&](index_t i) {
        const Vec point = load(points, i) - s.center;
        double solid_angle = 0.0;
        for (std::size_t face = 0; face < s.faces.size(); ++face) {
            auto [a, b, c] = s.corners(static_cast<unsigned>(face));
            a = a - point;
            b = b - point;
            c = c - point;
            const double la = norm(a);
            const double lb = norm(b);
            const double lc = norm(c);
            const double numerator = dot(a, cross(b, c));
            const double denominator =
                la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
            solid_angle += 2.0 * std::atan2(numerator, denominator);
        }
        winding[static_cast<std::size_t>(i)] = solid_angle / (4.0 * std::numbers::pi);
    });
}

} // namespace geraf2
