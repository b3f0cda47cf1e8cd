//! Links joined by fixed joints, as one rigid body with its mass.

use super::{DescriptionError, JointId, JointKind, Link, LinkId, Problem, Robot};
use downbeat_transforms::Isometry;
use glam::{DMat3, DVec3};
use nalgebra::Matrix3;

/// The links that are joined by fixed joints.
#[derive(Clone, Debug, PartialEq)]
pub struct Body {
    /// Its link nearest to the root, whose frame is that of the body.
    pub link: LinkId,
    /// The joint that moves it; `None` for the body of the root.
    pub joint: Option<JointId>,
    /// All its links with `body_from_link`, in tree order.
    pub links: Vec<(LinkId, Isometry)>,
    /// Its mass; `None` if none of its links has one, which is possible for the body of the root only.
    pub mass: Option<MassProperties>,
}

/// The mass of a rigid body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassProperties {
    /// In kg.
    pub mass: f64,
    /// The centre of mass in the frame of the body, in m.
    pub center_of_mass: DVec3,
    /// About the centre of mass, in the axes of the body, in kg m².
    pub inertia: DMat3,
}

/// By how much a principal moment of inertia may exceed the sum of the others, relative to it: rounding of
/// thin plates in files.
const INERTIA_TOLERANCE: f64 = 1e-3;

impl Robot {
    /// The rigid bodies, in tree order: that of the root first, then one for each joint that moves.
    ///
    /// ```
    /// use downbeat_kinematics::Robot;
    ///
    /// let robot = Robot::read("../../robots/darwin_op.urdf")?;
    /// let bodies = robot.bodies()?;
    /// assert_eq!(bodies.len(), 21);
    /// let mass: f64 = bodies.iter().filter_map(|body| body.mass).map(|mass| mass.mass).sum();
    /// assert!((mass - 2.925).abs() < 1e-3);
    /// # Ok::<(), downbeat_kinematics::DescriptionError>(())
    /// ```
    ///
    /// # Errors
    /// [`Problem::NoInertia`] if a body that moves has no mass; [`Problem::ImpossibleInertia`] if no
    /// distribution of mass has this inertia.
    pub fn bodies(&self) -> Result<Vec<Body>, DescriptionError> {
        let mut bodies: Vec<Body> = Vec::new();
        let mut body_of = Vec::with_capacity(self.links().len());
        for (index, link) in self.links().iter().enumerate() {
            let id = LinkId(index);
            let joint = link.parent.map(|joint| (joint, self.joint(joint)));
            let body_from_link = match joint {
                Some((_, joint)) if joint.kind == JointKind::Fixed => {
                    let (body, body_from_parent) = body_of[joint.parent.0];
                    (body, body_from_parent * joint.parent_from_joint)
                }
                _ => {
                    bodies.push(Body { link: id, joint: link.parent, links: Vec::new(), mass: None });
                    (bodies.len() - 1, Isometry::IDENTITY)
                }
            };
            body_of.push(body_from_link);
            let (body, body_from_link) = body_from_link;
            bodies[body].links.push((id, body_from_link));
        }
        for body in &mut bodies {
            let parts = body.links.iter().map(|&(id, body_from_link)| self.mass_of(id, body_from_link));
            let parts = parts.filter_map(Result::transpose).collect::<Result<Vec<_>, _>>()?;
            body.mass = MassProperties::sum(&parts);
            if body.mass.is_none() && body.joint.is_some() {
                return Err(self.no_mass(self.link(body.link)));
            }
        }
        Ok(bodies)
    }

    pub(crate) fn no_mass(&self, link: &Link) -> DescriptionError {
        self.error(Some(link.line), Problem::NoInertia { link: link.name.clone() })
    }

    /// The mass of a link in the frame of its body; `None` if it has none.
    fn mass_of(
        &self,
        id: LinkId,
        body_from_link: Isometry,
    ) -> Result<Option<MassProperties>, DescriptionError> {
        let link = self.link(id);
        let Some(inertial) = link.inertial.filter(|inertial| inertial.mass > 0.0) else { return Ok(None) };
        let mut moments = Matrix3::from(inertial.inertia.to_cols_array_2d()).symmetric_eigenvalues();
        moments.as_mut_slice().sort_by(f64::total_cmp);
        let [least, middle, greatest] = [moments[0], moments[1], moments[2]];
        if least.is_nan() || least <= 0.0 || greatest > (least + middle) * (1.0 + INERTIA_TOLERANCE) {
            let moments = format!("{least:.3e}, {middle:.3e}, {greatest:.3e}");
            let problem = Problem::ImpossibleInertia { link: link.name.clone(), moments };
            return Err(self.error(Some(link.line), problem));
        }
        let body_from_inertial = body_from_link * inertial.link_from_inertial;
        let rotation = DMat3::from_quat(body_from_inertial.rotation);
        Ok(Some(MassProperties {
            mass: inertial.mass,
            center_of_mass: body_from_inertial.translation,
            inertia: rotation * inertial.inertia * rotation.transpose(),
        }))
    }
}

impl MassProperties {
    /// Those of several rigidly connected masses in the same frame; `None` if there are none.
    ///
    /// Each inertia is moved to the common centre of mass by the parallel axis theorem,
    /// I = Σ Iᵢ + mᵢ (dᵢ·dᵢ 1 − dᵢ dᵢᵀ).
    fn sum(parts: &[Self]) -> Option<Self> {
        let mass: f64 = parts.iter().map(|part| part.mass).sum();
        if parts.is_empty() {
            return None;
        }
        let center_of_mass = parts.iter().map(|part| part.mass * part.center_of_mass).sum::<DVec3>() / mass;
        let mut inertia = DMat3::ZERO;
        for part in parts {
            let arm = part.center_of_mass - center_of_mass;
            let outer = DMat3::from_cols(arm * arm.x, arm * arm.y, arm * arm.z);
            inertia +=
                part.inertia + part.mass * (DMat3::from_diagonal(DVec3::splat(arm.length_squared())) - outer);
        }
        Some(Self { mass, center_of_mass, inertia })
    }
}
